//! What no single room can show: scenarios, two processes, conformance, golden charts.
