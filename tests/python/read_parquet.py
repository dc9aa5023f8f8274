"""Reads a sweep's episodes.parquet with DuckDB and compares it with episodes.csv, value by value.

    read_parquet.py FOLDER
"""

import pathlib
import sys

import duckdb

folder = pathlib.Path(sys.argv[1])
table, text = f"'{folder}/episodes.parquet'", f"read_csv('{folder}/episodes.csv')"
rows = duckdb.sql(f"select * from {table}")
differences = duckdb.sql(
    f"(select * from {table} except all select * from {text}) union all "
    f"(select * from {text} except all select * from {table})"
)
notes = dict(duckdb.sql(f"select decode(key), decode(value) from parquet_kv_metadata({table})").fetchall())
inside = notes["sweep.toml"] == (folder / "sweep.toml").read_text()
print(
    f"{len(rows)} rows, {len(rows.columns)} columns, {len(differences)} differences, "
    f"sweep.toml {'inside' if inside else 'is another'}"
)
