//! A client of the sidecar: flies through a world while it streams.
