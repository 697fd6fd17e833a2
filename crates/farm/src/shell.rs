//! A POSIX shell script that executes the levels of the graph one after another. The units of one
//! level do not depend on each other, so they can run in parallel.

use std::fmt::Write;

use crate::file::{File, line, quoted};
use crate::graph::Graph;

pub(crate) fn export(graph: &Graph) -> Vec<File> {
    let mut depth = vec![0usize; graph.units.len()];
    for (index, inputs) in graph.inputs().into_iter().enumerate() {
        depth[index] = inputs.into_iter().map(|input| depth[input] + 1).max().unwrap_or(0);
    }
    let mut text = String::from("#!/bin/sh\n");
    let _ = writeln!(text, "# {}", graph.name.replace('\n', " "));
    text.push_str(
        "# JOBS=N executes N units in parallel; calling the script again continues a run that was stopped\nset -e\n",
    );
    let _ = writeln!(
        text,
        "units() {{ xargs -P \"${{JOBS:-1}}\" -n 1 {} {}; }}\n",
        line(&graph.command),
        quoted(&graph.folder)
    );
    for level in 0..=depth.iter().copied().max().unwrap_or(0) {
        let ids = graph.units.iter().zip(&depth).filter(|(_, at)| **at == level).map(|(unit, _)| quoted(&unit.id));
        let _ = writeln!(text, "printf '%s\\n' {} | units", ids.collect::<Vec<_>>().join(" "));
    }
    vec![File::script("run.sh", text)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::tests::sample;

    #[test]
    fn a_level_holds_what_needs_nothing_of_it() {
        let text = &export(&sample())[0].text;
        let levels: Vec<&str> = text.lines().filter(|line| line.ends_with("| units")).collect();
        assert_eq!(levels[0], "printf '%s\\n' place | units");
        assert!(levels[1].contains("t0001/trace/1-of-2") && levels[1].contains("t0002/trace/2-of-2"));
        assert_eq!(levels.len(), 6);
    }

    /// The id must be the last word, since `xargs -I WORD` would also replace WORD in paths.
    #[test]
    fn a_unit_is_the_last_word_of_its_command() {
        let mut graph = sample();
        graph.folder = "/mnt/RAID/GRID {}".into();
        let text = &export(&graph)[0].text;
        let call = text.lines().find(|line| line.starts_with("units()")).unwrap();
        assert!(call.ends_with(" '/mnt/RAID/GRID {}'; }") && call.contains(" -n 1 "), "{call}");
    }
}
