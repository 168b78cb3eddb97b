"""Work that may be done anywhere, and twice: in this process, in others, or over a Ray cluster.

`jobs` says what a piece of work is and who does it, `local` does it on this machine, `cluster` on
Ray; `episodes` evaluates agents so, `sweep` trains policies.
"""
