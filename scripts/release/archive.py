#!/usr/bin/env python3
"""Packs a directory into DIR.zip, or DIR.tar.gz, and writes its SHA-256 beside it, in the form of sha256sum.

    scripts/release/archive.py dist/cartpole-dqn-0.1.0-x86_64-unknown-linux-musl tar.gz

The same files give the same bytes, on every system: names are sorted, and owners and times are left out.
"""

import gzip
import hashlib
import sys
import tarfile
import zipfile
from pathlib import Path


def tar_gz(files, archive):
    # No time and no name in the header of gzip.
    with open(archive, "wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=0) as packed:
        with tarfile.open(fileobj=packed, mode="w", format=tarfile.USTAR_FORMAT) as tar:
            for path, name, mode in files:
                entry = tarfile.TarInfo(name)
                entry.size, entry.mode = path.stat().st_size, mode
                with open(path, "rb") as file:
                    tar.addfile(entry, file)


def zip_(files, archive):
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as packed:
        for path, name, mode in files:
            entry = zipfile.ZipInfo(name)  # 1980, the earliest time that the format has
            entry.compress_type, entry.create_system, entry.external_attr = zipfile.ZIP_DEFLATED, 3, (0o100000 | mode) << 16
            packed.writestr(entry, path.read_bytes())


def main():
    kinds = {"tar.gz": tar_gz, "zip": zip_}
    if len(sys.argv) != 3 or sys.argv[2] not in kinds or not Path(sys.argv[1]).is_dir():
        sys.exit("usage: archive.py DIR tar.gz|zip")
    directory, kind = Path(sys.argv[1]), sys.argv[2]
    programs = ("cartpole-dqn", "cartpole-dqn.exe")
    paths = sorted(path for path in directory.rglob("*") if path.is_file())
    named = [(path, path.relative_to(directory.parent).as_posix(), 0o755 if path.name in programs else 0o644) for path in paths]
    archive = directory.with_name(f"{directory.name}.{kind}")
    kinds[kind](sorted(named, key=lambda item: item[1]), archive)
    digest = hashlib.sha256(archive.read_bytes()).hexdigest()
    archive.with_name(archive.name + ".sha256").write_bytes(f"{digest}  {archive.name}\n".encode())
    print(f"{archive}: {archive.stat().st_size} bytes, SHA-256 {digest}")


if __name__ == "__main__":
    main()
