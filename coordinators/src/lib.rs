//! The Coordination Level: nets, the functions they name, the data object manager
