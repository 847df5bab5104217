//! Movement primitives and control laws: numbers in, numbers out.
