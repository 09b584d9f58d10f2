-- Events, in the order in which they were stored.
CREATE TABLE event (
    sequence INTEGER PRIMARY KEY AUTOINCREMENT,
    id TEXT NOT NULL UNIQUE,
    wall_ns INTEGER NOT NULL,
    kind TEXT NOT NULL,
    axis TEXT,
    t_s REAL,
    frequency_hz REAL,
    power_n2 REAL,
    pitch_difference_rad REAL,
    text TEXT NOT NULL,
    acknowledged_by TEXT,
    acknowledged_ns INTEGER,
    silenced_until_ns INTEGER
) STRICT;

CREATE INDEX event_by_kind ON event (kind, sequence);
CREATE INDEX event_by_time ON event (wall_ns);

-- Every start of the service; its number is the epoch of the commands of that life.
CREATE TABLE life (
    epoch INTEGER PRIMARY KEY AUTOINCREMENT,
    started_ns INTEGER NOT NULL,
    version TEXT NOT NULL
) STRICT;
