//! Rapier stand-in for the testbed: PUMA 560, wrist lamp, ceiling cameras
