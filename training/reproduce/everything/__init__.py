"""Every table and figure of the three papers in one run, and a page that sets them side by side.

`rows`: the paper's value, ours, and why they differ; `item`: a table or figure; `neural_swarm`,
`dmpc_swarm`, `rth3d`: those of each paper, and how `*_rows` read what was measured; `registry`: all
of them; `runner`: one after another, going on after a kill; `page`, `look`, `markdown`: what is
written; `options`: `swarm-envs reproduce all`.
"""
