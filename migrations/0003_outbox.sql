-- How far each sink outside has confirmed the events: everything above is still to be sent, in order.
CREATE TABLE outbox (
    sink TEXT NOT NULL PRIMARY KEY,
    confirmed INTEGER NOT NULL
) STRICT;
