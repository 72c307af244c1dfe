-- What is in stored worlds, for SQLite and PostgreSQL alike. A version is a world as it was published once.

CREATE TABLE catalogue_versions (
    id           BIGINT PRIMARY KEY,
    identity     TEXT NOT NULL,
    name         TEXT NOT NULL,
    origin_x     DOUBLE PRECISION NOT NULL,  -- least corner of the first leaf, metres
    origin_y     DOUBLE PRECISION NOT NULL,
    origin_z     DOUBLE PRECISION NOT NULL,
    leaf_side    DOUBLE PRECISION NOT NULL,  -- metres
    splits_x     BIGINT NOT NULL,
    splits_y     BIGINT NOT NULL,
    splits_z     BIGINT NOT NULL,
    is_published BIGINT NOT NULL             -- 0 while it is being filled
);

CREATE UNIQUE INDEX catalogue_versions_by_identity ON catalogue_versions (name, identity);

CREATE TABLE catalogue_objects (
    version      BIGINT NOT NULL,
    id           BIGINT NOT NULL,
    name         TEXT NOT NULL,
    identity     TEXT NOT NULL,              -- hash of its bytes, or of its parameters
    PRIMARY KEY (version, id)
);

CREATE TABLE catalogue_cells (
    version      BIGINT NOT NULL,
    id           BIGINT NOT NULL,            -- 0 for the root; a cell's is larger than its parent's
    parent       BIGINT,
    level        BIGINT NOT NULL,            -- above the leaves
    x            BIGINT NOT NULL,
    y            BIGINT NOT NULL,
    z            BIGINT NOT NULL,
    min_x        DOUBLE PRECISION NOT NULL,  -- around what is in it, metres
    min_y        DOUBLE PRECISION NOT NULL,
    min_z        DOUBLE PRECISION NOT NULL,
    max_x        DOUBLE PRECISION NOT NULL,
    max_y        DOUBLE PRECISION NOT NULL,
    max_z        DOUBLE PRECISION NOT NULL,
    page         TEXT NOT NULL,              -- of the tree, where its node is
    PRIMARY KEY (version, id)
);

CREATE UNIQUE INDEX catalogue_cells_by_place ON catalogue_cells (version, level, x, y, z);

CREATE TABLE catalogue_representations (
    version       BIGINT NOT NULL,
    cell          BIGINT NOT NULL,
    id            BIGINT NOT NULL,           -- in the cell
    direction     TEXT,                      -- of an orthoview
    detail        BIGINT,                    -- of a geometry; 0 is the finest
    file          TEXT NOT NULL,
    wire_bytes    BIGINT NOT NULL,
    decoded_bytes BIGINT NOT NULL,
    error         DOUBLE PRECISION NOT NULL, -- metres
    PRIMARY KEY (version, cell, id)
);
