//! Graphs of units of work.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

/// Kinds of units.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The display's place in the scene.
    Place,
    /// One of the blocks into which the views of a light field are divided.
    Views,
    /// One of the blocks into which the scene's pictures for the zone score are divided.
    Score,
    /// A light field: rendered, read from a file, or made by a source plugin.
    Field,
    /// The patterns of one tile (a rectangle of the display) in one round over all tiles.
    Tile,
    /// The patterns of a display at a time step.
    Patterns,
    /// Outputs, scores and report of a display at a time step.
    Results,
    /// A design of a sweep.
    Design,
    /// All remaining steps of the run. They include a check that the run is complete.
    Finish,
}

impl Kind {
    /// Returns the name of the kind in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Place => "place",
            Self::Views => "views",
            Self::Score => "score",
            Self::Field => "field",
            Self::Tile => "tile",
            Self::Patterns => "patterns",
            Self::Results => "results",
            Self::Design => "design",
            Self::Finish => "finish",
        }
    }
}

/// A unit of work.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Unit {
    /// Id that is unique in the graph. If the unit is a block of a step, the id ends with
    /// `N-of-COUNT`, where N counts from 1.
    pub id: String,
    /// Kind of work.
    pub kind: Kind,
    /// Ids of the units whose results this unit reads.
    pub inputs: Vec<String>,
    /// Ids of the plan's steps that this unit executes.
    pub steps: Vec<String>,
    /// Only for a unit that is one block of a divided step: [number of this block, from 1; number
    /// of blocks].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub block: Option<[usize; 2]>,
    /// Only for a unit that solves a tile: the number of the round over all tiles, from 1. Tiles
    /// exchange their borders between rounds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub round: Option<usize>,
    /// Files and folders that this unit publishes, relative to the run folder.
    pub writes: Vec<String>,
    /// Expected time on one worker, seconds.
    pub seconds: f64,
    /// Expected memory, bytes.
    pub memory_bytes: u64,
}

/// All units of a run, and the command that executes a unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Graph {
    /// Name of the job.
    pub name: String,
    /// The run folder, absolute.
    pub folder: String,
    /// Beginning of a unit's command line, for example `lumistack farm unit`. The run folder and
    /// the unit's id follow.
    pub command: Vec<String>,
    /// The units, in an order in which each comes after its inputs.
    pub units: Vec<Unit>,
}

/// Units whose ids differ only in the number of the block. A unit that is no block forms a group
/// alone.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Group<'a> {
    /// Common beginning of the units' ids.
    pub(crate) name: &'a str,
    /// The units, by ascending number of their block.
    pub(crate) units: Vec<&'a Unit>,
    /// Numbers of the groups whose results this group reads, ascending.
    pub(crate) inputs: Vec<usize>,
}

impl Group<'_> {
    /// Returns the expected time of the longest unit, seconds.
    pub(crate) fn seconds(&self) -> f64 {
        self.units.iter().map(|unit| unit.seconds).fold(0.0, f64::max)
    }

    /// Returns the expected memory of the largest unit, bytes.
    pub(crate) fn memory_bytes(&self) -> u64 {
        self.units.iter().map(|unit| unit.memory_bytes).max().unwrap_or(0)
    }

    /// Returns the id of a unit of this group. If the units are blocks, `number` stands for the
    /// number of the block.
    pub(crate) fn id_with(&self, number: &str) -> String {
        match self.units[0].block {
            Some([_, count]) => format!("{}/{number}-of-{count}", self.name),
            None => self.units[0].id.clone(),
        }
    }
}

impl Graph {
    /// Returns the command line of a unit.
    pub fn command(&self, id: &str) -> Vec<String> {
        self.command.iter().cloned().chain([self.folder.clone(), id.to_owned()]).collect()
    }

    /// Returns the index of each unit, by the unit's id.
    pub(crate) fn indices(&self) -> HashMap<&str, usize> {
        self.units.iter().enumerate().map(|(index, unit)| (unit.id.as_str(), index)).collect()
    }

    /// Returns, for each unit, the indices of its inputs.
    pub(crate) fn inputs(&self) -> Vec<Vec<usize>> {
        let indices = self.indices();
        let of = |unit: &Unit| unit.inputs.iter().filter_map(|id| indices.get(id.as_str()).copied()).collect();
        self.units.iter().map(of).collect()
    }

    /// Collects the units into groups; every group comes after its inputs.
    pub(crate) fn groups(&self) -> Vec<Group<'_>> {
        let mut groups: Vec<Group<'_>> = Vec::new();
        let mut of_unit = Vec::new();
        for (unit, inputs) in self.units.iter().zip(self.inputs()) {
            let name = match unit.block {
                Some(_) => unit.id.rsplit_once('/').map_or(unit.id.as_str(), |(name, _)| name),
                None => &unit.id,
            };
            let number = match groups.iter().rposition(|group| group.name == name) {
                Some(number) => number,
                None => {
                    groups.push(Group { name, units: Vec::new(), inputs: Vec::new() });
                    groups.len() - 1
                }
            };
            groups[number].units.push(unit);
            for input in inputs {
                let input = of_unit[input];
                if input != number && !groups[number].inputs.contains(&input) {
                    groups[number].inputs.push(input);
                }
            }
            of_unit.push(number);
        }
        groups.iter_mut().for_each(|group| group.inputs.sort_unstable());
        groups
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Makes a graph of two time steps with two blocks of views each.
    pub(crate) fn sample() -> Graph {
        let unit = |id: &str, kind, inputs: &[&str], seconds| Unit {
            id: id.into(),
            kind,
            inputs: inputs.iter().map(|id| id.to_string()).collect(),
            steps: vec![id.into()],
            block: id.ends_with("-of-2").then(|| [usize::from(id.ends_with("2-of-2")) + 1, 2]),
            round: None,
            writes: Vec::new(),
            seconds,
            memory_bytes: 100 << 20,
        };
        let mut units = vec![unit("place", Kind::Place, &[], 1.0)];
        for time in ["t0001", "t0002"] {
            let views = [1, 2].map(|block| format!("{time}/trace/{block}-of-2"));
            units.extend(views.iter().map(|id| unit(id, Kind::Views, &["place"], 8.0)));
            let views = views.each_ref().map(String::as_str);
            units.push(unit(&format!("{time}/expose"), Kind::Field, &views, 1.0));
            let field = format!("{time}/expose");
            let mut inputs = vec![field.as_str()];
            inputs.extend((time == "t0002").then_some("t0001/factorize"));
            units.push(unit(&format!("{time}/factorize"), Kind::Patterns, &inputs, 2.0));
        }
        units.push(unit("finish", Kind::Finish, &["t0002/factorize"], 1.0));
        Graph {
            name: "it's a \"walk\" $1".into(),
            folder: "/shots/a b".into(),
            command: ["lumistack", "farm", "unit"].map(String::from).to_vec(),
            units,
        }
    }

    #[test]
    fn blocks_are_one_group() {
        let graph = sample();
        let groups = graph.groups();
        let names: Vec<&str> = groups.iter().map(|group| group.name).collect();
        assert_eq!(
            names,
            [
                "place",
                "t0001/trace",
                "t0001/expose",
                "t0001/factorize",
                "t0002/trace",
                "t0002/expose",
                "t0002/factorize",
                "finish"
            ]
        );
        assert_eq!(groups[1].units.len(), 2);
        assert_eq!(groups[1].id_with("#"), "t0001/trace/#-of-2");
        assert_eq!((groups[2].inputs.clone(), groups[6].inputs.clone()), (vec![1], vec![3, 5]));
        assert_eq!(groups[2].id_with("#"), "t0001/expose");
    }
}
