//! OpenCue: a Python script for PyOutline. The script has an OpenCue layer per group of units, and
//! an OpenCue frame per unit.

use std::fmt::Write;

use crate::file::{File, plain};
use crate::graph::Graph;

/// Writes a string literal of Python.
fn literal(text: &str) -> String {
    // serde_json writes only escapes that are also valid in Python.
    serde_json::to_string(text).expect("texts serialize")
}

pub(crate) fn export(graph: &Graph) -> Vec<File> {
    let groups = graph.groups();
    let mut text = String::from(
        "#!/usr/bin/env python3\n\"\"\"Submits a job to OpenCue: python3 job.py. Needs the packages opencue-pyoutline and opencue-pycue.\"\"\"\n\nimport outline\nimport outline.cuerun\nfrom outline.modules.shell import Shell\n\n\ndef make():\n",
    );
    let _ = writeln!(text, "    job = outline.Outline({}, frame_range=\"1\")", literal(&plain(&graph.name)));
    text.push_str("    layers = {}\n");
    // Make one OpenCue layer per group, after the layers that it depends on.
    for group in &groups {
        // OpenCue replaces `#IFRAME#` by the number of a frame, which is the number of a block.
        let mut words = graph.command(&group.id_with("#IFRAME#"));
        let frames = match group.units.len() {
            1 if group.units[0].block.is_none() => "1".to_owned(),
            count => format!("1-{count}"),
        };
        let words: Vec<String> = words.drain(..).map(|word| literal(&word)).collect();
        let memory = group.memory_bytes().div_ceil(1 << 20).max(256);
        let _ = writeln!(
            text,
            "    layer = Shell({}, command=[{}], range={}, memory=\"{memory}m\")",
            literal(&plain(group.name)),
            words.join(", "),
            literal(&frames)
        );
        for &input in &group.inputs {
            let _ = writeln!(text, "    layer.depend_all(layers[{}])", literal(groups[input].name));
        }
        let _ = writeln!(text, "    layers[{}] = layer\n    job.add_layer(layer)", literal(group.name));
    }
    text.push_str(
        "    return job\n\n\nif __name__ == \"__main__\":\n    outline.cuerun.launch(make(), use_pycuerun=False)\n",
    );
    vec![File::script("job.py", text)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::tests::sample;

    #[test]
    fn a_layer_has_a_frame_per_block() {
        let text = &export(&sample())[0].text;
        assert!(text.contains("\"t0001/trace/#IFRAME#-of-2\"], range=\"1-2\""), "{text}");
        assert!(text.contains("depend_all(layers[\"t0001/trace\"])"), "{text}");
    }
}
