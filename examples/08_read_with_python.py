"""Reads a recording with nothing but Python's own sqlite3:  08_read_with_python.py run.db load"""
import sqlite3
import sys
from datetime import datetime, timezone

path, topic = (sys.argv[1:] + ["run.db", "load"][len(sys.argv) - 1:])[:2]
db = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
db.row_factory = sqlite3.Row

tables = [row["table_name"] for row in
          db.execute("SELECT table_name FROM rtdata_topic WHERE topic = ? ORDER BY version", (topic,))]
if not tables:
    sys.exit(f"{path} has no topic {topic}")
rows = 0
for table in tables:  # one, unless the fields changed between runs
    quoted = '"' + table.replace('"', '""') + '"'
    for row in db.execute(f"SELECT * FROM {quoted} ORDER BY run, origin, sequence"):
        rows += 1
        if rows > 5:
            continue
        when = datetime.fromtimestamp(row["time"] / 1e9, timezone.utc)
        fields = {key: row[key] for key in row.keys() if key not in ("run", "time", "origin", "sequence", "checksum~")}
        print(when.isoformat(timespec="milliseconds"), row["origin"], row["sequence"], fields)
print(rows, "rows")

stored = 0
for entry in db.execute("SELECT * FROM rtdata_ledger WHERE topic = ? ORDER BY run, origin", (topic,)):
    dropped = entry["dropped_newest"] + entry["dropped_oldest"] + entry["dropped_refused"] + entry["dropped_unsaved"]
    stored += entry["stored"] - entry["pruned"]
    print(f"run {entry['run']} {entry['origin']}: scheduled {entry['scheduled']} taken {entry['taken']} "
          f"missed {entry['missed']} failed {entry['failed']}; unreadable {entry['unreadable']}; offered {entry['offered']} stored {entry['stored']} "
          f"dropped {dropped}")
sys.exit(0 if rows == stored else 1)
