"""A flight as Rerun's own file: pip install rerun-sdk; python examples/python/to_rerun.py runs/demo/crpl

Reads flight.html of a run folder and writes flight.rrd beside it. `rerun runs/demo/crpl/flight.rrd` shows the path, the
obstacles, what the model believes and predicts on the pictures that were received, and SNR, rate, risk and power.
"""

import argparse
import base64
import io
import json
import pathlib

import rerun as rr
import rerun.blueprint as rrb
from PIL import Image, ImageOps

PIXELS = 100  # a picture's side is the field's
LOW, HIGH, BELIEVED, OBSTACLE = [0, 114, 178], [213, 94, 0], [0, 158, 115], [91, 107, 140]
CURVES = {"snr_db": "SNR, dB", "rate": "rate, bits an interval", "p_coll": "risk of collision", "power": "transmit power"}


def lines(page):
    """The lines inside flight.html; docs/watch.md says what they hold."""
    block = page.read_text(encoding="utf-8").split('id="flight">')[1].split("</script>")[0]
    return [json.loads(line) for line in block.splitlines() if line.strip()]


def place(point):
    """A place of the unit square in pixels of a picture whose up is the field's."""
    return [PIXELS * point[0], PIXELS * (1 - point[1])]


def picture(message):
    """The picture as it was received; its first row is the field's lower edge."""
    image = ImageOps.flip(Image.open(io.BytesIO(base64.b64decode(message["png"]))))
    file = io.BytesIO()
    image.save(file, "PNG")
    return rr.EncodedImage(contents=file.getvalue(), media_type="image/png", draw_order=-1)


class Flight:
    """Tells one vehicle's lines to Rerun."""

    def __init__(self, name, scenario, dt_s):
        self.name, self.dt_s = name, dt_s
        self.radii = [PIXELS * obstacle["radius"] for obstacle in scenario.get("obstacle", [])]
        station, goal = scenario["channel"]["base_station"], scenario["goal"]
        marks = rr.Points2D([place(station), place(goal)], labels=["base station", "goal"], radii=1)
        rr.log(f"{name}/field/places", marks, static=True)

    def tick(self, message):
        colour = HIGH if message["power"] > 1 else LOW
        field = f"{self.name}/field"
        step = [place(message["r"]), place(message["r_next"])]
        rr.log(f"{field}/path", rr.LineStrips2D([step], colors=colour, radii=0.4))
        rr.log(f"{field}/vehicle", rr.Points2D([place(message["r"])], colors=colour, radii=1.5))
        places = [place(centre) for centre in message["obstacles"]]
        sizes = [[radius, radius] for radius in self.radii[: len(places)]]
        rr.log(f"{field}/obstacles", rr.Ellipses2D(centers=places, half_sizes=sizes, colors=OBSTACLE))
        for key in CURVES:
            rr.log(f"{self.name}/curves/{key}", rr.Scalars(message[key]))
        if message["outage"]:
            rr.log(f"{self.name}/log", rr.TextLog("outage", level="WARN"))

    def belief(self, message):
        field = f"{self.name}/field"
        sizes = [[2 * PIXELS * sigma for sigma in message["sigma"]]]
        ellipse = rr.Ellipses2D(centers=[place(message["position"])], half_sizes=sizes, colors=BELIEVED)
        rr.log(f"{field}/believed", ellipse)
        paths = [[place(point) for point in path] for path in message.get("fan", [])]
        rr.log(f"{field}/predicted", rr.LineStrips2D(paths, colors=BELIEVED, radii=0.15))

    def picture(self, message):
        rr.log(f"{self.name}/field/picture", picture(message))

    def command(self, message):
        if message["fate"] != "delivered":
            rr.log(f"{self.name}/log", rr.TextLog(f"command of interval {message['tick']}: {message['fate']}"))


def look(names):
    """What stands where in the viewer."""
    def one(name):
        curves = [
            rrb.TimeSeriesView(name=title, origin=f"{name}/curves/{key}", contents=f"{name}/curves/{key}")
            for key, title in CURVES.items()
        ]
        flown = rrb.VisibleTimeRanges(
            timeline="time", start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
        )
        field = rrb.Spatial2DView(name=name, origin=f"{name}/field", overrides={f"{name}/field/path": flown})
        return rrb.Horizontal(field, rrb.Vertical(*curves, rrb.TextLogView(origin=f"{name}/log")), name=name)

    return rrb.Blueprint(rrb.Tabs(*map(one, names)), rrb.TimePanel(timeline="time"))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=pathlib.Path, help="run folder, or a flight.html")
    parser.add_argument("--out", type=pathlib.Path, help="file to write [default: flight.rrd beside flight.html]")
    args = parser.parse_args()
    page = args.run / "flight.html" if args.run.is_dir() else args.run
    out = args.out or page.with_name("flight.rrd")
    told = lines(page)
    hello = [message for message in told if message["kind"] == "hello"][-1]
    names = {vehicle["id"]: vehicle["name"] for vehicle in hello["vehicles"]}

    rr.init("crpl")
    rr.save(out, default_blueprint=look(names.values()))
    rr.send_recording_name(hello["title"])
    flights = {vehicle: Flight(name, hello["scenario"], hello["dt_s"]) for vehicle, name in names.items()}
    flown = 0
    for message in told:
        kind, flight = message["kind"], flights.get(message.get("vehicle"))
        if flight is None or not hasattr(flight, kind):
            continue
        rr.set_time("tick", sequence=message["tick"])
        rr.set_time("time", duration=message["tick"] * hello["dt_s"])
        getattr(flight, kind)(message)
        flown += kind == "tick"
    print(f"{flown} intervals in {out}")


if __name__ == "__main__":
    main()
