"""Grading of submissions, which run in sandboxes and exchange only numbers with the grader.

Order of reading: `pipes` (messages between grader and submission), `sandbox`, `work` (the process
in the sandbox), `submission` (the grader's side of it), `assignment`, `copies` (detection of
copies), `grade` (the table and its files).
"""
