"""Grading of submissions: they answer with numbers, and cannot influence their marks.

Order of reading: `pipes` (what passes between grader and work), `sandbox` (what the work's process
sees), `work` (what runs there), `submission` (the work as the grader sees it), `assignment` (what
is asked for, with `planner` and `force`), `copies` (what others have written, recognized), `grade`
(the table and its files).
"""
