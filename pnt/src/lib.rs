//! Petri net transducers: text form, execution, analysis
