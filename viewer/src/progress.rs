//! One line.
