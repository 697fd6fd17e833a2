//! Tests the README of the published crate `lumistack-cli`.

use crate::common;
use crate::common::triangle::write_triangle;
use crate::common::{lumistack, succeed};

#[test]
fn the_commands_on_the_command_s_page_work() {
    let page = std::fs::read_to_string(common::root().join("crates/cli/README.md")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    std::fs::rename(write_triangle(folder.path()), folder.path().join("model.gltf")).unwrap();
    let lines: Vec<&str> = page.lines().filter(|line| line.starts_with("lumistack ")).collect();
    assert!(lines.len() > 2, "{lines:?}");
    for line in lines {
        let words = line.split_whitespace().skip(1).map(|word| word.replace("model.glb", "model.gltf"));
        let mut command = lumistack();
        command.current_dir(&folder).args(words);
        if line.starts_with("lumistack run ") {
            command.args(["--resolution", "24x15", "--samples", "2", "--iterations", "3"]);
        }
        succeed(&mut command);
    }
    assert!(folder.path().join("view.png").is_file() && folder.path().join("runs/model/report.html").is_file());
}
