//! Any bytes read as an ONNX file give columns or error messages, and the graph between all columns can be evaluated.
#![no_main]

use libfuzzer_sys::fuzz_target;
use metafmu::import::{interface::{ColumnSource, Mapping, OutputSource}, onnx};

fuzz_target!(|bytes: &[u8]| {
    let Ok(imported) = onnx::read(bytes, None) else { return };
    let inputs = imported.inputs.len();
    let mapping = Mapping {
        inputs: (0..inputs).map(ColumnSource::Input).collect(),
        outputs: (0..imported.outputs.len()).map(OutputSource::Column).collect(),
        states: Vec::new(),
    };
    let Ok(graph) = imported.into_graph(&mapping, inputs) else { return };
    graph.check(inputs, mapping.outputs.len()).expect("a graph that was read is a valid one");
});
