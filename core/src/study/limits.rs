//! Largest numbers that several parts of a study may have.

/// Maximum number of runs in a set. Their points take a few gigabytes.
pub(super) const MAX_RUNS: usize = 10_000_000;

/// Parameters, inputs or outputs at most: each takes a few kilobytes where an FMU is made and in every host.
pub const MAX_VARIABLES: usize = 200_000;

/// Maximum number of parameters of a Sobol plan, which needs direction numbers for each.
pub const MAX_SOBOL_PARAMETERS: usize = 100;

/// Parameters a Halton plan can have: larger bases fill the ranges only after very many points.
pub const MAX_HALTON_PARAMETERS: usize = 16;
