"""Check that a wheel has the packages and what they need, and nothing else: `python tests/project/wheel.py WHEEL`."""

import sys
import zipfile
from pathlib import PurePath

names = [PurePath(name) for name in zipfile.ZipFile(sys.argv[1]).namelist()]
tops = {path.parts[0] for path in names}
assert {"allocator", "mpc"} <= tops, tops
assert all(top.startswith("antagonist-") for top in tops - {"allocator", "mpc"}), tops
assert not [path for path in names if {"tests", "rigs", "__pycache__"} & set(path.parts) or path.stem == "conftest"]
for needed in ("allocator/py.typed", "mpc/py.typed", "mpc/explorer/page.html", "mpc/data/joint.toml"):
    assert PurePath(needed) in names, needed
print(f"{len(names)} files, as they should be")
