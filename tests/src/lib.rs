//! End-to-end tests and fixtures.
