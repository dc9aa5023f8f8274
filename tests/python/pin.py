"""Writes requirements.txt and requirements-package.txt anew: each package at the version below, with the
hash of every wheel that Linux on x86_64 or aarch64 may need. A version without a wheel for one of them is an error.

    python3 tests/python/pin.py [FILE]
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
# What builds the Python package `crpl`, and what its tests import.
PACKAGE = {
    "ast-serialize": "0.13.1",  # mypy's
    "cloudpickle": "3.1.3",  # Gymnasium's
    "fastcrc": PACKAGES["fastcrc"],
    "farama-notifications": "0.0.6",  # Gymnasium's
    "gymnasium": "1.4.0",
    "iniconfig": "2.3.1",  # pytest's
    "librt": "0.17.0",  # mypy's
    "lxml": PACKAGES["lxml"],
    "maturin": "1.16.0",
    "mypy": "2.4.1",
    "mypy-extensions": "1.2.0",
    "numpy": "2.4.6",
    "packaging": "26.4",  # pytest's
    "pandas": "3.1.1",
    "pathspec": "1.1.1",  # mypy's
    "pettingzoo": "1.27.0",  # the environment of several vehicles
    "pluggy": "1.7.0",  # pytest's
    "pygments": "2.21.0",  # pytest's
    "pymavlink": PACKAGES["pymavlink"],  # an example's companion
    "pytest": "9.2.0",
    "python-dateutil": "4.0.0",  # pandas's
    "typing-extensions": "4.16.0",
    "tzdata": "2026.6",  # pandas's
}
PYTHONS = ["3.10", "3.11", "3.12", "3.13", "3.14"]
MACHINES = ["x86_64", "aarch64"]
GLIBC = ["2_28", "2_27", "2_26", "2_24", "2_17", "2_12"]

PACKAGE_HEAD = """\
# Made by pin.py, which says why each is here: the build and the tests of the Python package.
--require-hashes
--only-binary :all:
"""
HEAD = """\
# Made by pin.py, which says why each is here. To be installed with --no-deps: MAVProxy without a window
# runs on these, and what else it names (OpenCV, VTK, Matplotlib, ...) is only for its maps and graphs.
--require-hashes
--only-binary :all:
"""


def download(packages, python, machine, folder):
    version = python.replace(".", "")
    platforms = [f"manylinux_{glibc}_{machine}" for glibc in GLIBC] + ["any"]
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--only-binary", ":all:", "--dest", folder, "--python-version", python]
    command += ["--implementation", "cp", "--abi", f"cp{version}", "--abi", "abi3", "--abi", "none"]
    command += [word for platform in platforms for word in ("--platform", platform)]
    subprocess.run(command + [f"{name}=={version}" for name, version in packages.items()], check=True)


def pin(file, head, packages, pythons):
    hashes = {name: set() for name in packages}
    with tempfile.TemporaryDirectory() as folder:
        for python in pythons:
            for machine in MACHINES:
                download(packages, python, machine, folder)
        for wheel in pathlib.Path(folder).iterdir():
            name = wheel.name.split("-")[0].lower().replace("_", "-")
            hashes[name].add(hashlib.sha256(wheel.read_bytes()).hexdigest())
    lines = [
        f"{name}=={version}" + "".join(f" \\\n    --hash=sha256:{digest}" for digest in sorted(hashes[name]))
        for name, version in packages.items()
    ]
    pathlib.Path(__file__).with_name(file).write_text(head + "\n".join(lines) + "\n")


def main():
    files = {
        "requirements.txt": (HEAD, PACKAGES, PYTHONS),
        "requirements-package.txt": (PACKAGE_HEAD, PACKAGE, PYTHONS[1:]),
    }
    for file in sys.argv[1:] or files:
        pin(file, *files[file])


if __name__ == "__main__":
    main()
