"""What the site needs beyond Sphinx: pages from docstrings, tables of options and state, links."""
