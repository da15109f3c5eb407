//! The `maille` command.
fn main() {}
