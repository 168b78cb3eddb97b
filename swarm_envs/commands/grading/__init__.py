"""How a stranger's work is graded: it is asked for actions, and has no hand in its mark.

Order of reading: `messages` (what passes between grader and work), `confinement` (what the work's
process may do), `child` (what runs there), `requirements` and `views` (what passes, as data),
`remote` (the work as an agent of the grader), `copies` (what ships, recognised), `text` (what is
printed of strangers' words).
"""
