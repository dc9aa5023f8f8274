//! Stub while the dependencies compile.
