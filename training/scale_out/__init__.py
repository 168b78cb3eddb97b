"""Work that may be done anywhere, and twice: in this process, in others, or over a Ray cluster.

`jobs` says what a piece of work is and does it on this machine, `options` chooses who does it and
reaches Ray clusters; `episodes` evaluates agents so.
"""
