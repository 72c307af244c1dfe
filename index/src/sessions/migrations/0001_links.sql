-- What is believed of the links of clients, by the name that they give themselves, for SQLite and PostgreSQL alike.

CREATE TABLE link_estimates (
    client      TEXT PRIMARY KEY,
    rate        DOUBLE PRECISION NOT NULL,  -- bytes per busy second
    latency_s   DOUBLE PRECISION NOT NULL,
    weight_s    DOUBLE PRECISION NOT NULL,  -- seconds of observation behind it, as they counted at updated_ms
    updated_ms  BIGINT NOT NULL             -- milliseconds since 1970-01-01 UTC
);

CREATE INDEX link_estimates_by_age ON link_estimates (updated_ms);
