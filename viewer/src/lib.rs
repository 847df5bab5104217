//! What people look at: reports, recordings, charts as pictures.
