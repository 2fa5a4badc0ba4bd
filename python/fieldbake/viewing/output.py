"""A view in the output of a notebook's cell without widgets: a page in a frame, and a picture."""

from __future__ import annotations

import base64
import html
import math
from typing import Any

from .content import Content
from .html import page_of

#: Height of a row of controls below the canvas, and the width of all controls in one row, CSS pixels.
ROW_PX, CONTROLS_PX = 28, 620


def frame_html(page: str, size: tuple[int, int]) -> str:
    """An iframe with a whole page inside, which needs no file and no network."""
    width, height = size
    # Two rows of notes come after the rows of controls.
    rows = 2 + math.ceil(CONTROLS_PX / max(width, 240))
    return (
        f'<iframe srcdoc="{html.escape(page, quote=True)}" width="{width}" height="{height + ROW_PX * rows}" '
        'style="border:0;max-width:100%" sandbox="allow-scripts allow-downloads"></iframe>'
    )


#: Output that shows a widget on static pages. nbconvert prefers the widget to its page and its picture, and needs a
#: network to draw widgets. The script finds the place of the widget there and draws the view from the state that the
#: notebook has saved, or shows the picture. Live notebooks have no such place.
STATIC = """<img hidden id="fb-{model}" src="data:image/png;base64,{picture}" alt="">
<script>
addEventListener("DOMContentLoaded", async () => {{
  const model = "{model}";
  const tags = (kind) => [...document.querySelectorAll(`script[type="application/vnd.jupyter.widget-${{kind}}+json"]`)];
  const content = (tag) => JSON.parse(tag.textContent);
  const place = tags("view").find((tag) => content(tag).model_id === model);
  if (!place) return;
  const saved = tags("state").map((tag) => content(tag).state[model]).find((found) => found?.state._esm);
  const image = document.getElementById(`fb-${{model}}`);
  const el = document.createElement("div");
  el.append(image);
  image.hidden = false;
  place.replaceWith(el);
  if (!saved) return;
  const values = {{ ...saved.state }};
  for (const {{ path, data }} of saved.buffers ?? []) {{
    values[path[0]] = new DataView(Uint8Array.from(atob(data), (character) => character.charCodeAt(0)).buffer);
  }}
  const address = URL.createObjectURL(new Blob([values._esm], {{ type: "text/javascript" }}));
  const {{ default: viewer }} = await import(address);
  const set = (name, value) => (values[name] = value);
  const ignore = () => {{}};
  const own = {{ get: (name) => values[name], set, save_changes: ignore, on: ignore, off: ignore }};
  await viewer.render({{ model: own, el }});
  image.remove();
}});
</script>"""


class PageOutput:
    """The page of a view as the output of a cell. Made by ``show`` where anywidget is not installed."""

    def __init__(self, content: Content) -> None:
        self._content = content

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        picture = base64.b64encode(self._content.frame(max(self._content.size))._repr_png_()).decode()
        page = frame_html(page_of(self._content), self._content.size)
        return {"text/plain": repr(self), "text/html": page, "image/png": picture}

    def __repr__(self) -> str:
        return f'PageOutput({self._content.title}; pip install "fieldbake[notebook]" for a widget that answers Python)'
