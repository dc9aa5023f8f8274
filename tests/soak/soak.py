"""Many vehicles, stations that come and go, lossy links, a router that is restarted, disks that are full.

    soak.py --bin target/release --minutes 60
    soak.py --bin target/release --peers 70

One `sitl` with 20 vehicles; behind links that lose 5 % of the datagrams each way two `gcs bridge`, each of which
logs to a full disk. One bridge is restarted again and again. Three stations come, ask the vehicles for things,
among them to boot anew, so that their clocks jump back, and leave without a word. Printed, and an error if not
kept:

- memory: the slope of each program's resident memory over the second half of the time
- no lost command unaccounted: each is acknowledged in the end, as often as the links and the restarts lose it
- no station left behind: each hears all vehicles soon after it has come; those that left are forgotten
"""

import argparse
import atexit
import os
import random
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request

os.environ["MAVLINK20"] = "1"

from pymavlink.dialects.v20 import common as mavlink  # noqa: E402

VEHICLES = 20
LOSS = 0.05
# A station asks again as `gcs` does.
RETRY_S, ATTEMPTS = 0.7, 60
# All vehicles are heard after this time, or a station was left behind: a restart takes a second or two.
HEARD_S = 60.0
# Resident memory may grow by this much in the second half: allocators settle slowly.
GROWTH_KIB = 4096
QUIET_S = 75.0

random.seed(1)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Program:
    """A program, and what it says."""

    def __init__(self, *words):
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.said = []
        # Whatever ends this script ends its programs.
        atexit.register(self.process.kill)
        for stream in (self.process.stdout, self.process.stderr):
            threading.Thread(target=self._read, args=(stream,), daemon=True).start()

    def _read(self, stream):
        for line in stream:
            self.said = [*self.said[-200:], line.rstrip()]

    def wait_for(self, word):
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            for line in self.said:
                if word in line:
                    return line
            assert self.process.poll() is None, (self.process.args, self.said)
            time.sleep(0.05)
        raise AssertionError((word, self.said))

    def rss_kib(self):
        with open(f"/proc/{self.process.pid}/status") as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        self.process.wait(60)
        assert self.process.returncode == 0, (self.process.args, self.process.returncode, self.said[-20:])


class Relay(threading.Thread):
    """A path to the vehicles that loses datagrams, both ways."""

    def __init__(self, to):
        super().__init__(daemon=True)
        self.to = ("127.0.0.1", to)
        self.front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.front.bind(("127.0.0.1", 0))
        self.port = self.front.getsockname()[1]
        self.behind = {}
        self.lost = self.carried = 0

    def run(self):
        while True:
            ready, _, _ = select.select([self.front, *self.behind], [], [], 0.5)
            for one in ready:
                try:
                    data, sender = one.recvfrom(65536)
                except OSError:
                    continue
                if random.random() < LOSS:
                    self.lost += 1
                    continue
                self.carried += 1
                if one is self.front:
                    self._up(data, sender)
                else:
                    self.front.sendto(data, self.behind[one])

    def _up(self, data, sender):
        known = next((one for one, address in self.behind.items() if address == sender), None)
        if known is None:
            known = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.behind[known] = sender
            # A bridge that is gone does not come back by this address.
            for old in list(self.behind)[:-2]:
                del self.behind[old]
                old.close()
        known.sendto(data, self.to)


class Station:
    """One visit of a station: it comes, asks, and leaves when its time is over."""

    def __init__(self, port, number):
        self.to = ("127.0.0.1", port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.mav = mavlink.MAVLink(None, srcSystem=255 - number, srcComponent=190)
        self.reader = mavlink.MAVLink(None)
        self.reader.robust_parsing = True
        self.came = time.monotonic()
        self.beat = 0.0
        self.heard = set()
        self.newest = {}
        self.all_heard = None
        self.pending = None
        self.asked = self.acknowledged = self.repeated = 0

    def send(self, message):
        data = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        try:
            self.socket.sendto(data, self.to)
        except OSError:
            pass  # The bridge is being restarted.

    def ask(self):
        vehicle = random.randint(1, VEHICLES)
        number, params = random.choice([
            (mavlink.MAV_CMD_REQUEST_MESSAGE, (148,)),
            (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (30, random.choice((-1, 0, 200_000)))),
            (mavlink.MAV_CMD_DO_SET_MODE, (1, random.choice((4, 5, 17)))),
            (mavlink.MAV_CMD_DO_CHANGE_SPEED, (1, 5)),
            (mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (1,)),
        ])  # fmt: skip
        self.asked += 1
        self.pending = [vehicle, number, (*params, *[0.0] * 7)[:7], 0, 0.0]

    def turn(self, now, leaving):
        if now - self.beat > 1.0:
            self.beat = now
            self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if self.pending is None and not leaving and self.all_heard is not None:
            self.ask()
        if self.pending is not None and now - self.pending[4] > RETRY_S:
            vehicle, number, params, tries, _ = self.pending
            quiet = now - self.newest.get(vehicle, self.came)
            assert tries < ATTEMPTS, (
                f"command {number} to vehicle {vehicle} was never acknowledged; its newest frame is {quiet:.1f} s old"
            )
            self.repeated += tries > 0
            self.pending[3:] = [tries + 1, now]
            self.send(mavlink.MAVLink_command_long_message(vehicle, 1, number, min(tries, 255), *params))
        self.read(now)
        if self.all_heard is None:
            missing = set(range(1, VEHICLES + 1)) - self.heard
            assert now - self.came < HEARD_S, f"left behind: vehicles {sorted(missing)} not heard in {HEARD_S} s"

    def read(self, now):
        while True:
            try:
                data = self.socket.recv(65536)
            except OSError:
                return
            for message in self.reader.parse_buffer(data) or []:
                kind = message.get_type()
                self.newest[message.get_srcSystem()] = now
                if kind == "HEARTBEAT" and message.get_srcComponent() == 1 and self.all_heard is None:
                    self.heard.add(message.get_srcSystem())
                    if len(self.heard & set(range(1, VEHICLES + 1))) == VEHICLES:
                        self.all_heard = now - self.came
                elif kind == "COMMAND_ACK" and self.pending is not None:
                    vehicle, number, *_ = self.pending
                    if (message.get_srcSystem(), message.command) == (vehicle, number):
                        self.acknowledged += 1
                        self.pending = None


def slope(samples):
    """KiB a minute of (seconds, KiB), by least squares."""
    n = len(samples)
    mean_t, mean_m = sum(t for t, _ in samples) / n, sum(m for _, m in samples) / n
    spread = sum((t - mean_t) ** 2 for t, _ in samples)
    return 60.0 * sum((t - mean_t) * (m - mean_m) for t, m in samples) / spread if spread else 0.0


def bridge(programs, path, port, metrics):
    words = [f"{programs}/gcs", "bridge", "--connect", f"udpout:127.0.0.1:{path.port}"]
    words += ["--forward", f"udpin:127.0.0.1:{port}", "--metrics", f"127.0.0.1:{metrics}"]
    # The log's disk is full from the first byte on; routing goes on.
    started = Program(*words, "--tlog", "/dev/full", "--every", "0")
    started.wait_for("metrics")
    return started


def links_of(metrics):
    with urllib.request.urlopen(f"http://127.0.0.1:{metrics}/metrics", timeout=10) as answer:
        text = answer.read().decode()
    return len({line.split('link="')[1].split('"')[0] for line in text.splitlines() if 'link="' in line})


def crowd(vehicles, port, count):
    """So many peers, one after the other, each for 2 s: what `sitl` grows by."""
    for k in range(1, count + 1):
        peer = Station(port, 0)
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            now = time.monotonic()
            if now - peer.beat > 1.0:
                peer.beat = now
                peer.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            peer.read(now)
            time.sleep(0.01)
        peer.socket.close()
        if k % 10 == 0 or k == 1:
            print(f"{k:3} peers one after the other: {vehicles.rss_kib()} KiB", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True)
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--peers", type=int, help="in place of all that: so many peers, one after the other")
    flags = parser.parse_args()
    seconds = 60.0 * flags.minutes
    vehicles = Program(f"{flags.bin}/sitl", "--instances", str(VEHICLES), "--shared", "--open", "--listen", "udpin:127.0.0.1:0")
    port = int(vehicles.wait_for("listening on").rsplit(":", 1)[1].split()[0])
    if flags.peers:
        crowd(vehicles, port, flags.peers)
        vehicles.stop()
        return
    paths = [Relay(port), Relay(port)]
    for path in paths:
        path.start()
    ports, metrics = [free_port(), free_port()], [free_port(), free_port()]
    bridges = [bridge(flags.bin, *of) for of in zip(paths, ports, metrics, strict=True)]
    behind = [0, 0, 1]
    stations, leaves = [None] * 3, [0.0] * 3
    memory = {"sitl": [], "gcs bridge": []}
    begin = time.monotonic()
    sampled, restarts, visits, lives = 0.0, 0, 0, 0
    next_restart = begin + min(20.0, seconds / 4)
    asked = acknowledged = repeated = 0
    slowest = 0.0
    while True:
        now = time.monotonic()
        over = now - begin > seconds
        if now - sampled > 1.0:
            sampled = now
            assert vehicles.process.poll() is None, vehicles.said[-20:]
            memory["sitl"].append((now - begin, vehicles.rss_kib()))
            memory["gcs bridge"].append((now - begin, bridges[1].rss_kib()))
        if now > next_restart and not over:
            bridges[0].stop()
            time.sleep(random.uniform(0.0, 1.0))
            bridges[0] = bridge(flags.bin, paths[0], ports[0], metrics[0])
            restarts += 1
            next_restart = now + random.uniform(10.0, 40.0)
        for k, station in enumerate(stations):
            if station is None:
                if over:
                    continue
                visits += 1
                station = stations[k] = Station(ports[behind[k]], k)
                leaves[k] = now + random.uniform(5.0, 60.0)
            leaving = now > leaves[k] or over
            station.turn(now, leaving)
            if leaving and station.pending is None and station.all_heard is not None:
                asked, acknowledged = asked + station.asked, acknowledged + station.acknowledged
                repeated += station.repeated
                slowest = max(slowest, station.all_heard)
                station.socket.close()
                stations[k] = None
        if over and not any(stations):
            break
        time.sleep(0.005)
    lasted = (time.monotonic() - begin) / 60.0
    print(f"{lasted:.1f} min, {VEHICLES} vehicles, {visits} visits of 3 stations, {restarts} restarts of a bridge")
    lost, carried = sum(path.lost for path in paths), sum(path.carried for path in paths)
    print(f"links: {lost} of {lost + carried} datagrams lost")
    print(f"commands: {asked} asked, {acknowledged} acknowledged, {repeated} sent again")
    assert asked == acknowledged and asked > 0
    print(f"stations: all vehicles heard after {slowest:.1f} s at most")
    for name, samples in memory.items():
        half = samples[len(samples) // 2 :]
        grown = max(m for _, m in half[-5:]) - max(m for _, m in half[:5])
        print(f"memory of {name}: {half[-1][1]} KiB, slope {slope(half):.0f} KiB/min, grown {grown} KiB in the second half")
        assert grown < GROWTH_KIB, (name, grown)
    if flags.minutes >= 5:
        # Whoever has left is forgotten: the vehicles' link is left.
        time.sleep(QUIET_S)
        left = links_of(metrics[1])
        print(f"links of the bridge when all have left: {left}")
    for program in (*bridges, vehicles):
        program.stop()
    print("ok")


if __name__ == "__main__":
    sys.exit(main())
