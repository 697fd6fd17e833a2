//! GNU make: a target per unit. `make -j N` executes N units in parallel. With `-k`, make executes
//! other units after one has failed.

use std::fmt::Write;

use crate::file::{File, line};
use crate::graph::Graph;

/// Quotes a line of a recipe. A `$` is doubled, since make would expand it. A newline becomes a
/// space, since it would end the line.
fn recipe(command: &str) -> String {
    command.replace('$', "$$").replace('\n', " ")
}

pub(crate) fn export(graph: &Graph) -> Vec<File> {
    let mut text = format!(
        "# {}\n# make -j N executes N units in parallel; calling make again continues a run that was stopped\n\n",
        graph.name.replace('\n', " ")
    );
    text.push_str(".DELETE_ON_ERROR:\n");
    let ids: Vec<&str> = graph.units.iter().map(|unit| unit.id.as_str()).collect();
    let _ = writeln!(text, ".PHONY: all {}\n", ids.join(" "));
    let _ = writeln!(text, "all: {}\n", graph.units.last().map_or("", |unit| &unit.id));
    for unit in &graph.units {
        let rule = format!("{}: {}", unit.id, unit.inputs.join(" "));
        let _ = writeln!(text, "{}\n\t{}\n", rule.trim_end(), recipe(&line(&graph.command(&unit.id))));
    }
    vec![File::new("Makefile", text)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::tests::sample;

    #[test]
    fn a_rule_has_its_inputs_and_a_quoted_command() {
        let text = &export(&sample())[0].text;
        assert!(text.contains("\nt0002/factorize: t0002/expose t0001/factorize\n\t"), "{text}");
        assert!(text.contains("\tlumistack farm unit '/shots/a b' t0001/trace/2-of-2\n"), "{text}");
        assert!(text.contains("\nall: finish\n"), "{text}");
        assert!(text.contains("\nplace:\n\t"), "{text}");
    }
}
