//! Simplifiers that come as Python packages, one process per run.

use std::io::Write;
use std::process::{Command, Output, Stdio};

use anyhow::{Context, Result, bail, ensure};
use maille::Mesh;
use serde::Deserialize;

use crate::inputs::compact;
use crate::memory::Cost;
use crate::peer::Peer;

const SCRIPT: &str = include_str!("python_peer.py");

/// A simplifier of a Python package.
pub struct PythonPeer {
    name: &'static str,
    version: String,
}

/// What the script answers before the bytes of the result.
#[derive(Deserialize)]
struct Answer {
    seconds: f64,
    peak_bytes: Option<u64>,
    vertices: usize,
    triangles: usize,
}

impl PythonPeer {
    /// Those that the script can call.
    pub const NAMES: [&'static str; 2] = ["fast-simplification", "vtk"];

    /// Finds out whether the package is there, for the Python that `MAILLE_PYTHON` names or else `python3`.
    pub fn find(name: &'static str) -> Result<Self> {
        let output = output_of(python().args(["-c", SCRIPT, name]), &[])?;
        let version = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        Ok(Self { name, version })
    }
}

impl Peer for PythonPeer {
    fn name(&self) -> &str {
        self.name
    }

    fn version(&self) -> &str {
        &self.version
    }

    fn simplify(&self, mesh: &Mesh, triangles: usize) -> Result<(Mesh, Cost)> {
        let counts = [mesh.vertex_count(), mesh.triangle_count(), triangles].map(|count| count.to_string());
        let positions = mesh.positions.as_flattened().iter().flat_map(|x| x.to_le_bytes());
        let corners = mesh.triangles.as_flattened().iter().flat_map(|v| v.to_le_bytes());
        let input: Vec<u8> = positions.chain(corners).collect();
        let output = output_of(python().args(["-c", SCRIPT, self.name]).args(&counts), &input)?;
        let end = output.stdout.iter().position(|&byte| byte == b'\n').context("Python gave no answer")?;
        let answer: Answer = serde_json::from_slice(&output.stdout[..end])?;
        let cost = Cost { seconds: answer.seconds, peak_bytes: answer.peak_bytes };
        let (words, _) = output.stdout[end + 1..].as_chunks::<4>();
        ensure!(words.len() == 3 * (answer.vertices + answer.triangles), "Python gave half an answer");
        let (positions, corners) = words.split_at(3 * answer.vertices);
        let positions: Vec<[f32; 3]> = positions.as_chunks().0.iter().map(|p| p.map(f32::from_le_bytes)).collect();
        let triangles = corners.as_chunks().0.iter().map(|t| t.map(u32::from_le_bytes)).collect();
        Ok((compact(&positions, triangles)?, cost))
    }
}

fn python() -> Command {
    Command::new(std::env::var_os("MAILLE_PYTHON").unwrap_or_else(|| "python3".into()))
}

/// Runs a program on an input; if it fails, the error is the last line it wrote.
fn output_of(command: &mut Command, input: &[u8]) -> Result<Output> {
    let program = command.get_program().to_string_lossy().into_owned();
    let command = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().with_context(|| program.clone())?;
    // the script reads all of its input before it writes, so neither waits for the other; one that dies early closes
    // the pipe, and what it said then tells more than the broken pipe
    let written = child.stdin.take().expect("it is piped").write_all(input);
    let output = child.wait_with_output()?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        bail!("{program}: {}", said.trim_end().lines().next_back().unwrap_or("failed without a word"));
    }
    written?;
    Ok(output)
}
