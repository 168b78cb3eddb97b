"""How submissions are graded: they return actions, and cannot influence their marks.

Order of reading: `messages` (what passes between grader and work), `confinement` (what the work's
process may do), `child` (what runs there), `remote` (the work as an agent of the grader), `copies`
(included agents, recognised), `grades` (the table and its files).
"""
