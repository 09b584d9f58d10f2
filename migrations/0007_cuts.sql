-- What was cut: one row for each stretch of a cut at one speed and one pitch, and what became of it.
CREATE TABLE cut (
    sequence INTEGER PRIMARY KEY AUTOINCREMENT,
    id TEXT NOT NULL UNIQUE,
    began_ns INTEGER NOT NULL,
    lasted_s REAL NOT NULL,
    spindle_speed_rpm REAL NOT NULL,
    width_m REAL NOT NULL,
    feed_m_rev REAL NOT NULL,
    tool_position_m REAL,
    pitch_difference_rad REAL NOT NULL,
    outcome TEXT NOT NULL,
    line_hz REAL
) STRICT;
