-- Every write by a person or a program, chained by SHA-256 so that a change, a removal or another
-- order shows: hash = SHA-256 over the previous hash and this row's fields.
CREATE TABLE audit (
    sequence INTEGER PRIMARY KEY,
    wall_ns INTEGER NOT NULL,
    actor TEXT NOT NULL,
    role TEXT NOT NULL,
    action TEXT NOT NULL,
    detail TEXT NOT NULL,
    hash BLOB NOT NULL
) STRICT;
