-- Runs and what each policy reached in them, for SQLite and PostgreSQL alike.
-- Hashes are BLAKE3, hexadecimal. NULL is what was never reached or is unknown.

CREATE TABLE runs (
    id                 BIGINT PRIMARY KEY,
    started_at_ms      BIGINT NOT NULL,           -- milliseconds since 1970-01-01 UTC
    program_version    TEXT NOT NULL,
    build              TEXT NOT NULL,             -- of the executable's bytes
    suite_case         TEXT,
    folder             TEXT,                      -- in which the program ran
    arguments          TEXT NOT NULL,             -- JSON array of strings that repeats the run
    world              TEXT NOT NULL,
    world_hash         TEXT NOT NULL,
    path               TEXT NOT NULL,
    path_hash          TEXT NOT NULL,
    link               TEXT NOT NULL,
    link_hash          TEXT NOT NULL,
    settings           TEXT NOT NULL,             -- JSON object
    seed               TEXT NOT NULL,             -- decimal: up to 2^64
    inputs_hash        TEXT NOT NULL,             -- of the three hashes and the settings
    result_hash        TEXT NOT NULL,             -- of the document without what times a machine
    wall_s             DOUBLE PRECISION NOT NULL,
    peak_memory_bytes  BIGINT,
    nonempty_share     DOUBLE PRECISION,
    lambda             DOUBLE PRECISION,
    rho                DOUBLE PRECISION,
    mu                 DOUBLE PRECISION,
    largest_need_bytes BIGINT NOT NULL,
    bound_quality      DOUBLE PRECISION,
    bound_method       TEXT NOT NULL,
    document_hash      TEXT NOT NULL,             -- of the document's bytes
    checksum           TEXT NOT NULL,             -- of all columns above and of the run's results
    document           TEXT NOT NULL              -- JSON, as printed
);

CREATE INDEX runs_by_inputs ON runs (inputs_hash, program_version);

CREATE TABLE results (
    run_id             BIGINT NOT NULL REFERENCES runs (id),
    place              BIGINT NOT NULL,           -- in the document's list, from 0
    policy             TEXT NOT NULL,
    mean_quality             DOUBLE PRECISION,
    mean_quality_lower       DOUBLE PRECISION,
    mean_quality_upper       DOUBLE PRECISION,
    mean_deficit             DOUBLE PRECISION,
    mean_deficit_lower       DOUBLE PRECISION,
    mean_deficit_upper       DOUBLE PRECISION,
    p05_quality              DOUBLE PRECISION,
    p05_quality_lower        DOUBLE PRECISION,
    p05_quality_upper        DOUBLE PRECISION,
    seconds_below_0_9        DOUBLE PRECISION,
    seconds_below_0_9_lower  DOUBLE PRECISION,
    seconds_below_0_9_upper  DOUBLE PRECISION,
    seconds_to_0_9           DOUBLE PRECISION,
    seconds_to_0_9_lower     DOUBLE PRECISION,
    seconds_to_0_9_upper     DOUBLE PRECISION,
    share_within_16px        DOUBLE PRECISION,
    share_within_16px_lower  DOUBLE PRECISION,
    share_within_16px_upper  DOUBLE PRECISION,
    bytes_fetched            DOUBLE PRECISION,
    bytes_fetched_lower      DOUBLE PRECISION,
    bytes_fetched_upper      DOUBLE PRECISION,
    bytes_wasted             DOUBLE PRECISION,
    bytes_wasted_lower       DOUBLE PRECISION,
    bytes_wasted_upper       DOUBLE PRECISION,
    bytes_cancelled          DOUBLE PRECISION,
    bytes_cancelled_lower    DOUBLE PRECISION,
    bytes_cancelled_upper    DOUBLE PRECISION,
    evictions                DOUBLE PRECISION,
    evictions_lower          DOUBLE PRECISION,
    evictions_upper          DOUBLE PRECISION,
    decisions                DOUBLE PRECISION,
    decision_ns_p50          BIGINT NOT NULL,
    decision_ns_p99          BIGINT NOT NULL,
    decision_ns_max          BIGINT NOT NULL,
    PRIMARY KEY (run_id, place)
);
