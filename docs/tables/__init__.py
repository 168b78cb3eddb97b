"""The tables of the pages, made from docstrings, tables and results of the package.

A page marks the place of a table by a comment such as `<!-- option table: Hall -->`, and its end by
`<!-- end -->`. `make tables` writes what stands between them.
"""
