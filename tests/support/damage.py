"""Damage to files, as hypothesis draws it, and to Zarr stores, from random numbers."""

import json

from hypothesis import strategies as st


def damaged(data, content):
    """The bytes of a file cut off somewhere, or with some of them changed."""
    content = bytearray(content)
    if data.draw(st.booleans()):
        return content[: data.draw(st.integers(0, len(content) - 1))]
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    return content


def drop_checksum(path):
    """Remove the checksum from the JSON beside a file, so that damage of the file reaches its reader."""
    beside = path.with_name(f"{path.name}.json")
    if beside.exists():
        facts = json.loads(beside.read_text())
        del facts["checksum"]
        beside.write_text(json.dumps(facts))


#: Values that replace a value of JSON.
STRANGE = (0, -1, 1, 2, 0.5, 2**31, 2**63, 1e30, -1e308, float("nan"), float("inf"), "", "x", "nan", None, [], {}, True)


def damage_store(folder, random):
    """Damage one file of a Zarr store in place. Returns a description and a function that restores the file."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    metadata = [path for path in files if path.name == "zarr.json"]
    if random.integers(4):
        # Half of the damage is in the metadata of the group, which has all numbers of the layout.
        path = folder / "zarr.json" if random.integers(2) else metadata[random.integers(len(metadata))]
        content = path.read_bytes()
        tree = json.loads(content)
        owner, key = places(tree)[random.integers(len(places(tree)))]
        what = f"{path.relative_to(folder)}: {key}"
        if random.integers(8) == 0:
            del owner[key]
        else:
            owner[key] = STRANGE[random.integers(len(STRANGE))]
            what += f" = {owner[key]!r}"
        path.write_text(json.dumps(tree))
    else:
        chunks = [path for path in files if path.name != "zarr.json"]
        path = chunks[random.integers(len(chunks))]
        content = path.read_bytes()
        data = bytearray(content)
        kind = random.integers(3)
        if kind == 0 and data:
            for _ in range(int(random.integers(1, 5))):
                data[random.integers(len(data))] = random.integers(256)
        elif kind == 1:
            del data[random.integers(len(data) + 1) :]
        else:
            data = data * 2
        what = f"{path.relative_to(folder)}: kind {kind}"
        path.write_bytes(data)
    return what, lambda: path.write_bytes(content)


def places(tree):
    """List the owner and the key of every value in a tree of JSON."""
    found = []
    rows = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in rows:
        found.append((tree, key))
        found.extend(places(value))
    return found
