"""Reads the files that `gcs export` wrote of one run folder with the programs that people have: DuckDB, gpxpy, the
reference reader of MCAP, and Python's own JSON; and compares them with record.jsonl.

    read_export.py FOLDER
"""

import json
import pathlib
import sys

import duckdb
import gpxpy
from mcap.reader import make_reader

folder = pathlib.Path(sys.argv[1])
records = [json.loads(line) for line in (folder / "record.jsonl").read_text().splitlines()]

table, text = f"'{folder}/flight.parquet'", f"read_csv('{folder}/flight.csv')"
rows = duckdb.sql(f"select * from {table}")
differences = duckdb.sql(f"(select * from {table} except all select * from {text})")
snr = [row[0] for row in duckdb.sql(f"select snr_db from {table} order by tick").fetchall()]
assert all(abs(a - b["snr_db"]) < 1e-4 for a, b in zip(snr, records, strict=True))
print(f"table: {len(rows)} rows, {len(differences)} differences")

(track,) = gpxpy.parse((folder / "flight.gpx").read_text()).tracks
points = track.segments[0].points
length, seconds = track.length_2d(), (points[-1].time - points[0].time).total_seconds()
print(f"gpx: {len(points)} points, {seconds:.1f} s")
places = [row[:2] for row in duckdb.sql(f"select latitude_deg, longitude_deg from {table}").fetchall()]
assert all(abs(p.latitude - a) < 1e-7 and abs(p.longitude - b) < 1e-7 for p, (a, b) in zip(points, places, strict=True))
assert 100 < length < 2000, length

features = json.loads((folder / "flight.geojson").read_text())["features"]
line = features[0]["geometry"]
outages = sum(feature["properties"]["name"] == "outage" for feature in features)
print(f"geojson: {line['type']} of {len(line['coordinates'])}, {outages == sum(r['outage'] for r in records)}")

with (folder / "flight.mcap").open("rb") as stream:
    reader = make_reader(stream)
    summary = reader.get_summary()
    messages = list(reader.iter_messages())
    flown = [json.loads(m.data) for _, channel, m in messages if channel.topic == "/record"]
    notes = [note.metadata for note in reader.iter_metadata()]
assert flown == records and "config.toml" in notes[0]
times = [m.log_time for _, _, m in messages]
assert times == sorted(times)
topics = {channel.topic for channel in summary.channels.values()}
print(f"mcap: {len(messages)} messages, {summary.statistics.message_count} told, {len(topics)} topics")
