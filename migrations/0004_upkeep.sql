-- Alarms that nobody acknowledged, found without reading the whole history. The kinds are those of severity
-- alarm: a test holds this list equal to the program's, and another list needs another migration.
CREATE INDEX event_open_alarm ON event (sequence)
WHERE acknowledged_ns IS NULL AND kind IN ('chatter_onset', 'command_failed', 'source_lost', 'fault',
    'invariant_violation', 'history_replaced', 'history_damaged');

-- SHA-256 of the settings of each life.
ALTER TABLE life ADD COLUMN settings TEXT;

-- The audit chain begins behind this row: what stood before it was removed by the retention.
CREATE TABLE audit_begin (
    one INTEGER PRIMARY KEY CHECK (one = 1),
    sequence INTEGER NOT NULL,
    hash BLOB NOT NULL
) STRICT;
