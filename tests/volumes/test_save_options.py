"""Options of `save` that the format of the file does not have."""

import numpy as np
import pytest

import fieldbake as fb

#: Each option with a usable value, and the endings that have it.
OPTIONS = {
    "band": (2.0, (".vdb", ".nvdb", ".dds", ".ktx2")),
    "compression": ("none", (".vdb", ".vti", ".nrrd")),
    "mipmaps": (True, (".dds", ".ktx2")),
    "columns": (2, (".exr",)),
}
ENDINGS = (".npz", ".vdb", ".nvdb", ".vti", ".nrrd", ".dds", ".ktx2", ".exr", ".vf")


@pytest.fixture(scope="module")
def volume():
    return fb.bake(fb.sphere(1), 8)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("option", OPTIONS)
def test_a_format_takes_its_own_options_only(volume, tmp_path, option, ending):
    value, endings = OPTIONS[option]
    path = tmp_path / f"v{ending}"
    if ending in endings:
        volume.save(path, **{option: value})
        found = fb.load(path)
        assert found.resolution == volume.resolution
        near = np.abs(volume.distances) < 1.5 * volume.spacing.max()
        assert np.array_equal(found.distances[near], volume.distances[near])
    else:
        with pytest.raises(fb.ArgumentError, match=f"^{option}: {ending} files have no {option}; .* have$"):
            volume.save(path, **{option: value})
        assert not list(tmp_path.iterdir())
