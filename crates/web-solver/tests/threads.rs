//! A `Work` that takes traced views from other objects of this type computes the same patterns as a
//! `Work` that traces all views itself.

use std::path::Path;

use lumistack_web_solver::{Files, Settings, Stage, Work};

const CHOICE: &str = r#"{"cols": 40, "frames": 2, "zone_samples": 150, "iterations": 2}"#;

fn work(folder: &str, file: &str) -> Work {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes").join(folder);
    let mut files = Files::default();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        files.add(&path.file_name().unwrap().to_string_lossy(), std::fs::read(&path).unwrap());
    }
    Work::new(files, file, Settings::from_json(CHOICE).unwrap()).unwrap()
}

fn placed() -> Work {
    let mut work = work("letters", "letters.gltf");
    while work.stage() == Stage::Scene {
        work.advance().unwrap();
    }
    work
}

/// Computes all pieces, and calls `between` after each. Returns the number of pieces.
fn finish(work: &mut Work, mut between: impl FnMut(&mut Work)) -> usize {
    let (mut pieces, mut last) = (0, work.share());
    while work.stage() != Stage::Done {
        work.advance().unwrap();
        between(work);
        assert!(work.share() >= last, "{} after {last}", work.share());
        (pieces, last) = (pieces + 1, work.share());
    }
    pieces
}

#[test]
fn views_of_other_works_give_the_same_patterns() {
    let mut alone = placed();
    let all = finish(&mut alone, |_| ());
    let mut helper = placed();
    // The helper answers after `delay` further pieces. With a long delay the `Work` traces some of
    // the given views itself, and later takes them a second time.
    for delay in [0, 1, 2, 9, 40] {
        let mut work = placed();
        let (mut given, mut asked) = (Vec::new(), std::collections::VecDeque::new());
        let pieces = finish(&mut work, |work| {
            if let Some(view) = work.give() {
                assert!(!given.contains(&view), "view {view} twice");
                given.push(view);
                asked.push_back(view);
            }
            if asked.len() > delay
                && let Some(view) = asked.pop_front()
            {
                work.take(view, helper.trace(view).unwrap()).unwrap();
            }
        });
        assert!(given.len() > 5, "only {} views", given.len());
        assert!(pieces < all || delay > 2, "{pieces} pieces, alone {all}, delay {delay}");
        assert_eq!(work.stack(), alone.stack(), "delay {delay}");
        assert_eq!(work.psnr().to_bits(), alone.psnr().to_bits());
    }
}

#[test]
fn a_refresh_without_new_views_is_left_out() {
    let (mut work, mut helper) = (placed(), placed());
    while let Some(view) = work.give() {
        work.take(view, helper.trace(view).unwrap()).unwrap();
    }
    // all views were taken, so there is only one refresh, of three iterations, before the last
    // solve
    finish(&mut work, |_| ());
    assert_eq!(work.shown(), 3 + 1);
    let mut alone = placed();
    finish(&mut alone, |_| ());
    assert_eq!(work.stack(), alone.stack());
}

#[test]
fn wrong_views_are_refused() {
    let refused = |work: &mut Work, view: usize, values: Vec<f32>, expected: &str| {
        let error = work.take(view, values).unwrap_err().to_string();
        assert_eq!(error, expected);
    };
    let mut early = work("letters", "letters.gltf");
    assert!(early.give().is_none() && early.trace(0).is_err());
    refused(&mut early, 0, Vec::new(), "the display is not placed in the scene yet");
    let mut work = placed();
    let view = work.give().unwrap();
    let mut values = work.trace(view).unwrap();
    refused(&mut work, 1000, values.clone(), "view: expected an existing view with all its values, found 17000 values");
    values.pop();
    refused(&mut work, view, values, "view: expected an existing view with all its values, found 16999 values");
    assert!(work.trace(1000).is_err());
    // other settings have other views
    let values = work.trace(view).unwrap();
    work.change(Settings::from_json(r#"{"cols": 32, "frames": 2}"#).unwrap()).unwrap();
    refused(&mut work, view, values.clone(), "the display is not placed in the scene yet");
    while work.stage() == Stage::Scene {
        work.advance().unwrap();
    }
    refused(&mut work, view, values, "view: expected an existing view with all its values, found 17000 values");
}

#[test]
fn splats_are_not_given() {
    let mut work = work("dandelion", "dandelion.spz");
    finish(&mut work, |work| assert_eq!(work.give(), None));
}
