//! Documents as charts.
