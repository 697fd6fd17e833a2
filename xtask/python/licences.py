"""Adds the file TEXT to the licences in a wheel.

usage: licences.py WHEEL TEXT
"""

import base64
import csv
import hashlib
import io
import sys
import zipfile
from pathlib import Path

wheel, text = Path(sys.argv[1]), Path(sys.argv[2])
with zipfile.ZipFile(wheel) as archive:
    entries = [(info, archive.read(info)) for info in archive.infolist()]
record = next(info.filename for info, _ in entries if info.filename.endswith(".dist-info/RECORD"))
name = f"{record.removesuffix('/RECORD')}/licenses/{text.name}"
content = text.read_bytes()
digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
    for info, data in entries:
        if info.filename == record:
            rows = list(csv.reader(io.StringIO(data.decode())))
            rows = [row for row in rows if row and row[0] != name]
            rows.insert(len(rows) - 1, [name, f"sha256={digest}", str(len(content))])
            lines = io.StringIO()
            csv.writer(lines, lineterminator="\n").writerows(rows)
            # installers expect RECORD, the list of files, as the last file of a wheel
            archive.writestr(zipfile.ZipInfo(name, info.date_time), content, zipfile.ZIP_DEFLATED)
            data = lines.getvalue().encode()
        if info.filename != name:
            archive.writestr(info, data, zipfile.ZIP_DEFLATED)
