"""The style sheet of the page: one column on a telephone, a table where there is room."""

STYLE = """
:root { --ink: #202428; --soft: #60656b; --line: #dfe3e8; --paper: #ffffff; --shade: #f5f7f9;
  --agrees: #17703c; --explained: #8a5a00; --unexplained: #b00020; --link: #0b5cad; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ec; --soft: #a3a9b0; --line: #3a4047;
  --paper: #16191c; --shade: #1f2327; --agrees: #67c98d; --explained: #e0ab4f;
  --unexplained: #ff7b8c; --link: #7ab8ff; } img { background: #ffffff; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1200px; padding: 16px 20px 60px; color: var(--ink);
  background: var(--paper); font: 16px/1.5 system-ui, sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.6rem; line-height: 1.2; } h2 { font-size: 1.3rem; margin-top: 2.5rem; }
h3 { font-size: 1.08rem; margin: 0; } p { margin: 0.5rem 0; } a { color: var(--link); }
.soft { color: var(--soft); }
section.item { border-top: 1px solid var(--line); padding: 18px 0 10px; }
table { border-collapse: collapse; width: 100%; margin: 10px 0; font-size: 0.94rem; }
th, td { text-align: left; vertical-align: top; padding: 5px 10px 5px 0;
  border-bottom: 1px solid var(--line); }
th { color: var(--soft); font-weight: 600; } td.number { font-variant-numeric: tabular-nums; }
td:nth-child(1) { width: 30%; } td:nth-child(5) { width: 32%; }
.agrees { color: var(--agrees); } .explained { color: var(--explained); }
.unexplained, .failed { color: var(--unexplained); font-weight: 600; }
img { max-width: 100%; height: auto; display: block; margin: 10px 0; border-radius: 4px; }
pre { background: var(--shade); padding: 8px 12px; border-radius: 4px; white-space: pre-wrap;
  font-size: 0.85rem; }
code { font-size: 0.92em; } details > summary { cursor: pointer; color: var(--soft); }
nav { display: flex; flex-wrap: wrap; gap: 4px 14px; }
@media (max-width: 760px) {
  body { padding: 12px 14px 40px; }
  table, tbody, tr, td { display: block; width: 100% !important; } thead { display: none; }
  tr { border-bottom: 1px solid var(--line); padding: 8px 0; }
  td { border: 0; padding: 1px 0; } td:empty { display: none; }
  td[data-name]::before { content: attr(data-name) ": "; color: var(--soft); }
  td:nth-child(1) { font-weight: 600; }
}
"""
"""CSS without a link to anywhere."""
