"""The bar of a notebook: it states the time that is left."""

import sys
from types import SimpleNamespace

from fieldbake.base import progress


def test_bars_of_notebooks_state_the_time_left(monkeypatch):
    shown, clock = [], [100.0]
    handle = SimpleNamespace(update=shown.append)
    display = SimpleNamespace(HTML=str, display=lambda bar, **_: shown.append(bar) or handle)
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(display=display))
    monkeypatch.setattr(progress, "_is_notebook", lambda: True)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    with progress.progress_callback(True, "bake") as callback:
        callback(0.0)
        # A quarter took 1,300 s, so the rest takes 3,900 s.
        clock[0] += 1300
        callback(0.25)
    assert "left" not in shown[0]
    assert shown[1].endswith("</progress> 1:05:00 left")
    assert shown[-1] == ""
