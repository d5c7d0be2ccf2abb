//! The `metafmu` command.

fn main() {}
