"""Extensions of Sphinx for the site: pages from docstrings, tables of options and state, links."""
