"""The experiments of the RTH3D paper, remade with this package's planners.

`experiments`: what each figure varies; `cells`: a run, its rule and its name; `curves`: runs of a
size together, fitted power laws; `claims`: what the curves should show, and do or do not;
`pictures`, `patterns`, `page`: how it is shown; `options`: `swarm-envs reproduce rth3d`.
"""
