"""Packs a wheel from a `.dist-info` folder, the package's Python sources and a compiled module. Prints the wheel's path.

usage: pack.py DIST_INFO SOURCES MODULE OUT     (in the wheel, MODULE is `lumistack/_lumistack.abi3.so`)
"""

import base64
import hashlib
import sys
import zipfile
from email.parser import Parser
from pathlib import Path


def main() -> None:
    info, sources, module, out = map(Path, sys.argv[1:])
    files = {"lumistack/_lumistack.abi3.so": module}
    for path in sorted(sources.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".so":
            files[path.relative_to(sources).as_posix()] = path
    for path in sorted(info.rglob("*")):
        if path.is_file():
            files[path.relative_to(info.parent).as_posix()] = path
    tag = Parser().parsestr((info / "WHEEL").read_text())["Tag"]
    wheel = out / f"{info.stem}-{tag}.whl"
    out.mkdir(parents=True, exist_ok=True)
    record = []
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, path in files.items():
            data = path.read_bytes()
            digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
            record.append(f"{name},sha256={digest},{len(data)}")
            archive.writestr(name, data)
        name = f"{info.name}/RECORD"
        archive.writestr(name, "\n".join([*record, f"{name},,", ""]))
    print(wheel)


main()
