"""Start of every kernel that executes a page: objects show their live view, in a frame that holds its page."""

from fieldbake.base.viewable import Viewable
from fieldbake.viewing.output import frame_html

#: Size of a view on a page, CSS pixels.
SIZE = (480, 360)


def live_view(view: Viewable) -> str:
    """The live view of an object as HTML."""
    return frame_html(view.to_html(size=SIZE), SIZE).replace("<iframe", '<iframe loading="lazy"')


get_ipython().display_formatter.formatters["text/html"].for_type(Viewable, live_view)  # noqa: F821
