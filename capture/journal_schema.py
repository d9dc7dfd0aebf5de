"""Tables of a journal, as `docs/session.md` documents them."""

from __future__ import annotations

SCHEMA_VERSION = 1

ADDED = """
CREATE TABLE levels (
    level INTEGER PRIMARY KEY,
    time TEXT NOT NULL,
    visit INTEGER NOT NULL REFERENCES visits (visit),
    temperature_deg_c TEXT NOT NULL,
    voltage_v TEXT NOT NULL,
    current_ma TEXT NOT NULL,
    load TEXT NOT NULL,
    lamp_deg_c REAL,
    lamp_output REAL,
    lamp_drift REAL
)"""
"""A table that the first journals of this version lack; they get it when they are opened to be changed."""

SCHEMA = f"""
CREATE TABLE poses (
    pose INTEGER PRIMARY KEY,
    wi TEXT NOT NULL,
    wo TEXT NOT NULL,
    angles_rad TEXT,
    refused TEXT,
    CHECK ((angles_rad IS NULL) <> (refused IS NULL))
);
CREATE TABLE visits (
    visit INTEGER PRIMARY KEY,
    role TEXT NOT NULL CHECK (role IN ('white', 'sample', 'trap', 'dark')),
    pose INTEGER NOT NULL,
    station TEXT,
    angles_rad TEXT NOT NULL,
    held_ticks TEXT,
    held_rad TEXT,
    flags INTEGER NOT NULL DEFAULT 0,
    done INTEGER NOT NULL DEFAULT 0 CHECK (done IN (0, 1)),
    UNIQUE (role, pose)
);
CREATE TABLE shots (
    shot_id TEXT PRIMARY KEY,
    visit INTEGER NOT NULL REFERENCES visits (visit),
    frame INTEGER NOT NULL,
    exposure_s REAL NOT NULL CHECK (exposure_s > 0),
    lit INTEGER NOT NULL CHECK (lit IN (0, 1)),
    state TEXT NOT NULL CHECK (state IN ('intent', 'filed', 'verified')),
    path TEXT,
    sha256 TEXT,
    statistics TEXT,
    time TEXT NOT NULL,
    UNIQUE (visit, frame)
);
CREATE TABLE events (
    event INTEGER PRIMARY KEY,
    time TEXT NOT NULL,
    kind TEXT NOT NULL,
    detail TEXT NOT NULL
);
{ADDED};
PRAGMA user_version = {SCHEMA_VERSION};
"""
