-- An alarm more: rows that were durable are missing at a start. The list of kinds is that of severity alarm.
DROP INDEX event_open_alarm;

CREATE INDEX event_open_alarm ON event (sequence)
WHERE acknowledged_ns IS NULL AND kind IN ('chatter_onset', 'command_failed', 'source_lost', 'fault',
    'invariant_violation', 'history_replaced', 'history_damaged', 'history_cut');
