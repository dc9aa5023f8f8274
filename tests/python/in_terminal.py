"""Runs a program in a terminal of so many columns, and prints each line of its stdout that is longer.

    in_terminal.py COLUMNS PROGRAM [ARGUMENT ...]
"""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios

columns, command = int(sys.argv[1]), sys.argv[2:]
terminal, its_side = pty.openpty()
fcntl.ioctl(its_side, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
program = subprocess.Popen(command, stdout=its_side, stdin=subprocess.DEVNULL)
os.close(its_side)
said = b""
while True:
    try:
        part = os.read(terminal, 65536)
    except OSError:  # Linux: the other side is closed
        break
    if not part:
        break
    said += part
lines = re.sub(rb"\x1b\[[0-9;?]*[A-Za-z]", b"", said).decode().splitlines()
for line in lines:
    if len(line) > columns:
        print(f"{len(line)} columns: {line}")
print(f"{len(lines) > 2}, exit status {program.wait()}")
