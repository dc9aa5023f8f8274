"""Writes requirements.txt anew: each package at the version below, with the hash of every wheel that
Linux on x86_64 or aarch64 may need. A version without a wheel for one of them is an error.

    python3 tests/python/pin.py
"""

import hashlib
import pathlib
import subprocess
import sys
import tempfile

PACKAGES = {
    "duckdb": "1.5.6",  # reads a sweep's Parquet
    "dronekit2": "3.0.0",
    "fastcrc": "0.5.0",  # pymavlink's checksums
    "gpxpy": "1.6.2",  # reads an exported track
    "lxml": "6.1.3",  # pymavlink's
    "lz4": "4.4.5",  # mcap's
    "mavproxy": "1.8.75",
    "mavsdk": "4.1.0",  # its C++ library is in the wheel
    "mcap": "1.3.0",  # reads an exported log
    "pillow": "12.3.0",  # opens the vehicle's pictures
    "pymavlink": "2.4.50",
    "pyserial": "3.5",  # MAVProxy's
    "zstandard": "0.25.0",  # mcap's
}
PYTHONS = ["3.10", "3.11", "3.12", "3.13", "3.14"]
MACHINES = ["x86_64", "aarch64"]
GLIBC = ["2_28", "2_27", "2_26", "2_24", "2_17"]

HEAD = """\
# Made by pin.py, which says why each is here. To be installed with --no-deps: MAVProxy without a window
# runs on these, and what else it names (OpenCV, VTK, Matplotlib, ...) is only for its maps and graphs.
--require-hashes
--only-binary :all:
"""


def download(python, machine, folder):
    version = python.replace(".", "")
    platforms = [f"manylinux_{glibc}_{machine}" for glibc in GLIBC] + ["any"]
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--only-binary", ":all:", "--dest", folder, "--python-version", python]
    command += ["--implementation", "cp", "--abi", f"cp{version}", "--abi", "abi3", "--abi", "none"]
    command += [word for platform in platforms for word in ("--platform", platform)]
    subprocess.run(command + [f"{name}=={version}" for name, version in PACKAGES.items()], check=True)


def main():
    hashes = {name: set() for name in PACKAGES}
    with tempfile.TemporaryDirectory() as folder:
        for python in PYTHONS:
            for machine in MACHINES:
                download(python, machine, folder)
        for wheel in pathlib.Path(folder).iterdir():
            name = wheel.name.split("-")[0].lower()
            hashes[name].add(hashlib.sha256(wheel.read_bytes()).hexdigest())
    lines = [
        f"{name}=={version}" + "".join(f" \\\n    --hash=sha256:{digest}" for digest in sorted(hashes[name]))
        for name, version in PACKAGES.items()
    ]
    pathlib.Path(__file__).with_name("requirements.txt").write_text(HEAD + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
