-- What each life of the service observed, for commissioning: evidence counts for the machine, method and turret
-- that it was gathered with.
CREATE TABLE observation (
    epoch INTEGER PRIMARY KEY,
    machine TEXT NOT NULL,
    started_ns INTEGER NOT NULL,
    observed_s REAL NOT NULL,
    cuts INTEGER NOT NULL,
    advised INTEGER NOT NULL,
    largest_pitch_rad REAL NOT NULL,
    compared INTEGER NOT NULL,
    mismatches INTEGER NOT NULL
) STRICT;

-- What a person says of an alarm: right or false.
ALTER TABLE event ADD COLUMN judged TEXT;
