"""Pages from notebooks with their outputs: a notebook becomes Markdown before it is parsed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any


def markdown(text: str) -> str:
    """A notebook as Markdown: its texts, code, and what the code printed and drew."""
    return "\n\n".join(part for cell in json.loads(text)["cells"] for part in _parts(cell))


def _parts(cell: dict[str, Any]) -> Iterator[str]:
    source = "".join(cell["source"])
    if cell["cell_type"] != "code":
        yield source
        return
    yield f"```python\n{source}\n```"
    for output in cell["outputs"]:
        data = output.get("data", {})
        said = "".join(output.get("text", data.get("text/plain", ""))).rstrip()
        if "image/png" in data:
            yield f"![](data:image/png;base64,{''.join(data['image/png']).strip()})"
        elif said and output.get("name") != "stderr":
            yield f"```text\n{said}\n```"


def setup(app: Any) -> dict[str, Any]:
    """Tell Sphinx."""

    def read(app: Any, page: str, content: list[str]) -> None:
        if app.env.doc2path(page).suffix == ".ipynb":
            content[0] = markdown(content[0])

    app.add_source_suffix(".ipynb", "markdown")
    app.connect("source-read", read)
    return {"parallel_read_safe": True}
