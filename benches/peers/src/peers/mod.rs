//! Other people's simplifiers.

mod meshoptimizer;
mod python;

pub use meshoptimizer::Meshoptimizer;
pub use python::PythonPeer;
