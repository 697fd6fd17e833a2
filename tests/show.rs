//! Tests of `lumistack show` on real compositors. They check the content and the order of frames on
//! every output, and the reaction to changes and losses of outputs.

#![cfg(feature = "panels")]

use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::time::Duration;

use lumistack_core::seed::Stream;
use lumistack_display::{Display, Flip, LayerStack, Panel, Transfer};

use crate::common::session::{NESTED, ON_X, Picture, SWAY, Screen, Session, XORG, wait_for};
use crate::common::show::Show;
use crate::common::{self, poke};

const FRAMES: usize = 4;

/// Returns a display of three layers for three outputs. The first layer has one panel pixel per
/// mask pixel. The second layer is upside down and has another gamma. The third layer is mirrored,
/// and has 2 × 2 panel pixels per mask pixel.
fn display(outputs: &[Screen]) -> Display {
    let mut display = Display::uniform([320, 180], 0.5, [3, 3], [10.0, 10.0], &[-10.0, 0.0, 10.0], FRAMES);
    display.brightness = 0.5;
    for (layer, (name, size, _)) in display.layers.iter_mut().zip(outputs) {
        layer.resolution = *size;
        layer.transfer = Transfer::Linear;
        layer.panel = Some(Panel { output: Some(name.to_string()), ..Panel::default() });
    }
    display.layers[1].transfer = Transfer::gamma(2.0);
    display.layers[1].panel.as_mut().unwrap().rotate_deg = 180;
    display.layers[2].resolution = [320, 180];
    display.layers[2].panel_pitch_mm = Some(0.25);
    display.layers[2].panel.as_mut().unwrap().flip = Flip::Horizontal;
    display
}

/// Returns the codes of a mask, `[row][col][rgb]`. The codes are noise, which differs between
/// stacks (numbered by `seed`), layers and frames. A strip at the top identifies the frame.
fn codes(seed: u64, layer: usize, frame: usize, [cols, rows]: [usize; 2]) -> Vec<u8> {
    let mut random = Stream::new(1000 * seed + 100 * layer as u64 + frame as u64);
    let noise = (0..rows * cols * 3).map(|_| (random.next_u64() & 255) as u8);
    let mut codes: Vec<u8> = noise.collect();
    for (i, pixel) in codes.chunks_exact_mut(3).enumerate().take(20 * cols) {
        // the strip has one stripe for each frame; only the stripe of the mask's own frame is
        // bright
        let lit = i % cols * FRAMES / cols == frame;
        pixel.fill(if lit { 255 } else { 20 });
    }
    codes
}

fn write_run(folder: &Path, display: &Display, seed: u64) {
    std::fs::create_dir_all(folder).unwrap();
    let mut stack = LayerStack::filled(display, 0.0);
    for (n, layer) in stack.layers.iter_mut().enumerate() {
        for frame in 0..FRAMES {
            let codes = codes(seed, n, frame, display.layers[n].resolution);
            // returns the linear value that the layer's transfer function encodes as this code
            let light = |code: u8| {
                let code = f32::from(code) / 255.0;
                if n == 1 { code * code } else { code }
            };
            layer.block_mut([frame]).iter_mut().zip(codes).for_each(|(value, code)| *value = light(code));
        }
    }
    std::fs::write(folder.join("display.toml"), display.to_toml()).unwrap();
    lumistack_field_io::write_stack(&folder.join("layers"), display, &stack).unwrap();
}

/// Computes the expected picture of an output, pixel by pixel, from the codes of the mask and the
/// mounting of the panel.
fn expected(seed: u64, n: usize, frame: usize, [cols, rows]: [usize; 2]) -> Picture {
    let mask = if n == 2 { [cols / 2, rows / 2] } else { [cols, rows] };
    let codes = codes(seed, n, frame, mask);
    let mut rgb = Vec::with_capacity(3 * cols * rows);
    for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
        let (r, c) = match n {
            1 => (rows - 1 - row, cols - 1 - col),
            2 => (row / 2, (cols - 1 - col) / 2),
            _ => (row, col),
        };
        rgb.extend_from_slice(&codes[3 * (r * mask[0] + c)..][..3]);
    }
    Picture { size: [cols, rows], rgb }
}

/// Computes the expected pictures of every output, each with its stack's seed and its frame's
/// number. This is done once, since a test compares many screenshots with them.
fn expected_on(outputs: &[Screen], seeds: &[u64]) -> Vec<Vec<((u64, usize), Picture)>> {
    let all: Vec<(u64, usize)> = seeds.iter().flat_map(|seed| (0..FRAMES).map(move |frame| (*seed, frame))).collect();
    let of =
        |n: usize, size| all.iter().map(|&(seed, frame)| ((seed, frame), expected(seed, n, frame, size))).collect();
    outputs.iter().enumerate().map(|(n, (_, size, _))| of(n, *size)).collect()
}

#[test]
fn every_output_shows_its_layer_pixel_for_pixel() {
    let Some(session) = Session::sway(&SWAY) else { return };
    let folder = tempfile::tempdir().unwrap();
    write_run(folder.path(), &display(&SWAY), 1);
    let mut show = Show::start(&session, folder.path(), &["--hold", "0"]);
    show.event("started");
    for frame in [0, 1, 2, 3, 1, 0] {
        show.tell(&format!("hold {frame}"));
        for (n, (name, size, _)) in SWAY.iter().enumerate() {
            let wanted = expected(1, n, frame, *size);
            wait_for(&format!("frame {frame} on {name}"), || session.grim(name).filter(|shown| *shown == wanted));
        }
    }
    // the command `nudge` moves the picture immediately, and `save` writes the shift to the file
    show.tell("nudge 0 3 -2");
    let plain = expected(1, 0, 0, SWAY[0].1);
    let moved = wait_for("the nudge", || session.grim(SWAY[0].0).filter(|shown| *shown != plain));
    assert_eq!(moved.part([3, 0], [317, 238]), plain.part([0, 2], [317, 238]));
    show.tell("save");
    show.event("saved");
    let kept = Display::from_toml(&std::fs::read_to_string(folder.path().join("display.toml")).unwrap()).unwrap();
    assert_eq!(kept.layers[0].panel.as_ref().unwrap().nudge_px, [3.0, -2.0]);
    let report = show.quit();
    println!("{report}");
    assert_eq!(report["submitted"]["out_of_order"], 0);
}

#[test]
fn frames_run_in_order_and_late_ones_are_counted() {
    let Some(session) = Session::sway(&SWAY) else { return };
    let folder = tempfile::tempdir().unwrap();
    write_run(folder.path(), &display(&SWAY), 1);
    let log = folder.path().join("log.csv");
    let mut show = Show::start(&session, folder.path(), &["--duration-s", "5", "--log", log.to_str().unwrap()]);
    show.event("started");
    let report = show.event("report");
    println!("{report}");
    let text = std::fs::read_to_string(&log).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|line| line.split(',').map(|number| number.parse().unwrap()).collect()).collect();
    assert_eq!(rows.len() as u64, report["refreshes"].as_u64().unwrap());
    // a busy machine may show few frames, but their order must be right
    assert!(rows.len() > 50, "{} refreshes in 5 s", rows.len());
    for (i, row) in rows.iter().enumerate() {
        assert_eq!((row[0] as usize, row[1] as usize), (i, i % FRAMES));
    }
    let interval = report["interval_s"].as_f64().unwrap();
    let late = rows.windows(2).filter(|pair| pair[1][3] - pair[0][3] > 1.5 * interval).count() as i64;
    // Count the late frames in the log, and compare the number with the report. The log rounds
    // times to microseconds, so a frame near the limit may be late in only one of the two. So a
    // difference of one frame is allowed.
    assert!((report["submitted"]["late"].as_i64().unwrap() - late).abs() <= 1, "{late} gaps in the log");
    // if the compositor reports presentation times, the times must rise and the skew must be known
    if report["presented"].as_object().is_some_and(|presented| !presented.is_empty()) {
        for (name, ..) in SWAY {
            assert_eq!(report["presented"][name]["out_of_order"], 0, "{report}");
        }
        assert!(report["skew_mean_s"].as_f64().is_some(), "{report}");
    } else {
        assert!(report["skew_mean_s"].is_null(), "{report}");
    }
}

#[test]
fn a_stack_that_is_written_anew_replaces_the_old_one() {
    let Some(session) = Session::sway(&SWAY) else { return };
    let folder = tempfile::tempdir().unwrap();
    let display = display(&SWAY);
    write_run(folder.path(), &display, 1);
    let mut show = Show::start(&session, folder.path(), &["--hold", "2"]);
    show.event("started");
    for seed in [1, 2, 3] {
        if seed > 1 {
            write_run(folder.path(), &display, seed);
        }
        for (n, (name, size, _)) in SWAY.iter().enumerate() {
            let wanted = expected(seed, n, 2, *size);
            wait_for(&format!("stack {seed} on {name}"), || session.grim(name).filter(|shown| *shown == wanted));
        }
    }
    assert!(show.quit()["swaps"].as_u64().unwrap() >= 3);
}

/// Takes screenshots while new stacks replace old ones. In every screenshot, all outputs must show
/// one frame of one stack.
fn one_frame_per_capture(
    capture: impl Fn() -> Option<Picture>,
    outputs: &[Screen],
    session: &Session,
    corner: [i32; 2],
) {
    let folder = tempfile::tempdir().unwrap();
    let display = display(outputs);
    write_run(folder.path(), &display, 1);
    let mut show = Show::start(session, folder.path(), &["--span"]);
    show.event("started");
    let place = |at: [i32; 2]| [0, 1].map(|axis| at[axis] - corner[axis]);
    let expected = expected_on(outputs, &[1, 2, 3]);
    // For each output, finds the stack and the frame whose expected picture it shows exactly.
    // Returns `None` if an output shows none of the expected pictures.
    let seen = |whole: &Picture| -> Option<Vec<(u64, usize)>> {
        let parts = outputs.iter().zip(&expected).map(|((_, size, at), all)| {
            let part = whole.part(place(*at), *size);
            all.iter().find(|(_, picture)| *picture == part).map(|(name, _)| *name)
        });
        parts.collect()
    };
    let mut last = wait_for("the first picture", || capture().and_then(|whole| seen(&whole)))[0];
    let (mut captures, mut frames, mut seeds) = (0, std::collections::BTreeSet::new(), vec![last.0]);
    for turn in 0..60 {
        if turn == 20 || turn == 40 {
            write_run(folder.path(), &display, 1 + turn / 20);
        }
        let Some(whole) = capture() else { continue };
        let Some(parts) = seen(&whole) else {
            whole.save(&std::env::temp_dir().join("span-capture.png"));
            panic!(
                "capture {turn} is no frame of any stack: {}",
                std::env::temp_dir().join("span-capture.png").display()
            );
        };
        assert!(parts.iter().all(|part| *part == parts[0]), "capture {turn} mixes {parts:?}");
        assert!(parts[0].0 >= last.0, "an old stack came back");
        last = parts[0];
        if !seeds.contains(&last.0) {
            seeds.push(last.0);
        }
        frames.insert(last.1);
        captures += 1;
    }
    // at the end the outputs show the last stack
    wait_for("the last stack", || capture().and_then(|whole| seen(&whole)).filter(|parts| parts[0].0 == 3));
    println!("{captures} captures, frames {frames:?}, stacks {seeds:?}: one frame index each; {}", show.quit());
    assert!(captures >= 50 && frames.len() >= 2);
}

#[test]
fn one_surface_across_all_outputs_never_mixes_frames_on_x11() {
    let Some(session) = Session::xorg(&XORG) else { return };
    one_frame_per_capture(|| session.import(), &XORG, &session, [0, 0]);
}

/// With `--span` one surface covers all outputs of sway. Screenshots of outputs are taken one after
/// another, so the test holds a frame while it takes them.
#[test]
fn one_surface_reaches_across_the_outputs_of_sway() {
    let Some(session) = Session::sway(&SWAY) else { return };
    let folder = tempfile::tempdir().unwrap();
    write_run(folder.path(), &display(&SWAY), 1);
    let mut show = Show::start(&session, folder.path(), &["--span", "--hold", "0"]);
    show.event("started");
    for frame in [0, 3, 1] {
        show.tell(&format!("hold {frame}"));
        for (n, (name, size, at)) in SWAY.iter().enumerate() {
            let wanted = expected(1, n, frame, *size);
            wait_for(&format!("frame {frame} on {name}"), || {
                session.grim_all().filter(|all| all.part(*at, *size) == wanted)
            });
        }
    }
    println!("{}", show.quit());
}

#[test]
fn every_output_of_an_x_server_shows_its_layer() {
    let Some(session) = Session::xorg(&XORG) else { return };
    let folder = tempfile::tempdir().unwrap();
    write_run(folder.path(), &display(&XORG), 1);
    let mut show = Show::start(&session, folder.path(), &["--hold", "0"]);
    show.event("started");
    for frame in 0..FRAMES {
        show.tell(&format!("hold {frame}"));
        for (n, (name, size, at)) in XORG.iter().enumerate() {
            let wanted = expected(1, n, frame, *size);
            wait_for(&format!("frame {frame} on {name}"), || {
                session.import().filter(|all| all.part(*at, *size) == wanted)
            });
        }
    }
    println!("{}", show.quit());
}

#[test]
fn outputs_that_are_missing_are_named() {
    let Some(session) = Session::sway(&SWAY[..2]) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut display = display(&SWAY);
    write_run(folder.path(), &display, 1);
    let text = common::succeed(session.command(env!("CARGO_BIN_EXE_lumistack")).args(["show", "--list"]));
    assert_eq!(text.lines().count(), 2, "{text}");
    assert!(text.starts_with("HEADLESS-1: 320 × 240 pixels at 0,0"), "{text}");
    let start = |display: &Display| {
        std::fs::write(folder.path().join("display.toml"), display.to_toml()).unwrap();
        common::fail(session.command(env!("CARGO_BIN_EXE_lumistack")).arg("show").arg(folder.path()))
    };
    let text = start(&display);
    let expected = "layers[2].panel.output: expected one of the outputs HEADLESS-1, HEADLESS-2, found \"HEADLESS-3\"";
    assert!(text.contains(expected), "{text}");
    display.layers[2].panel.as_mut().unwrap().output = None;
    let text = start(&display);
    let expected = "outputs: expected 3, one for each of layer 0, layer 1, layer 2; found HEADLESS-1, HEADLESS-2";
    assert!(text.contains(expected), "{text}");
}

/// Checks that the program ends correctly after an output is lost or changed. It must print the
/// message `expected`, end with exit code 1, and leave the display file unchanged. It must also
/// report the number of refreshes.
fn must_end(mut show: Show, folder: &Path, file: &str, expected: &str) {
    let report = show.event("report");
    assert!(report["refreshes"].as_u64().unwrap() > 0, "{report}");
    let (status, errors) = show.ended();
    assert_eq!(status.code(), Some(1), "{status}: {errors}");
    assert!(errors.contains(expected), "{errors}");
    println!("{}", errors.trim());
    assert_eq!(std::fs::read_to_string(folder.join("display.toml")).unwrap(), file);
}

#[test]
fn an_output_that_is_unplugged_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let display = display(&NESTED);
    write_run(folder.path(), &display, 1);
    for (options, gone, shows) in [(&[][..], "WL-2", 1), (&["--hold", "1"], "WL-1", 0), (&["--span"], "WL-3", 2)] {
        let Some(session) = Session::nested(&NESTED) else { return };
        let mut show = Show::start(&session, folder.path(), options);
        show.event("swapped");
        std::thread::sleep(Duration::from_millis(300));
        session.unplug(gone);
        let expected = format!(
            "output {gone} was disconnected while it showed layer {shows}. Check that the panel is plugged in and switched on"
        );
        must_end(show, folder.path(), &display.to_toml(), &expected);
    }
}

#[test]
fn an_output_that_changes_is_named() {
    let Some(session) = Session::sway(&SWAY) else { return };
    let folder = tempfile::tempdir().unwrap();
    let display = display(&SWAY);
    write_run(folder.path(), &display, 1);
    let mut show = Show::start(&session, folder.path(), &[]);
    show.event("swapped");
    assert!(session.command("swaymsg").arg("output HEADLESS-2 resolution 300x200").status().unwrap().success());
    let expected =
        "output HEADLESS-2, which shows layer 1: expected 400 × 300 pixels at 320,0 as at the start, found 300 × 200";
    must_end(show, folder.path(), &display.to_toml(), expected);
}

#[test]
fn an_output_of_an_x_server_that_is_switched_off_or_moved_is_named() {
    let Some(session) = Session::xorg(&XORG) else { return };
    let folder = tempfile::tempdir().unwrap();
    let display = display(&XORG);
    write_run(folder.path(), &display, 1);
    let randr = |words: &[&str]| assert!(session.command("xrandr").args(words).status().unwrap().success());
    let place = ["--output", "DUMMY1", "--mode", "400x300p", "--pos"];
    for options in [&[][..], &["--span"]] {
        let mut show = Show::start(&session, folder.path(), options);
        show.event("swapped");
        randr(&["--output", "DUMMY1", "--off"]);
        let expected = "output DUMMY1 was disconnected while it showed layer 1. Check that the panel is plugged in and switched on";
        must_end(show, folder.path(), &display.to_toml(), expected);
        randr(&[&place[..], &["320x0"]].concat());
    }
    let mut show = Show::start(&session, folder.path(), &[]);
    show.event("swapped");
    randr(&[&place[..], &["320x400"]].concat());
    let expected = "output DUMMY1, which shows layer 1: expected 400 × 300 pixels at 320,0 as at the start, found 400 × 300 at 320,400";
    must_end(show, folder.path(), &display.to_toml(), expected);
}

#[test]
fn outputs_are_kept_awake() {
    fn awake(node: &serde_json::Value) -> usize {
        let below = ["nodes", "floating_nodes"].iter().filter_map(|key| node[key].as_array()).flatten();
        usize::from(node["inhibit_idle"] == true) + below.map(awake).sum::<usize>()
    }
    let Some(session) = Session::sway(&SWAY) else { return };
    let folder = tempfile::tempdir().unwrap();
    write_run(folder.path(), &display(&SWAY), 1);
    let mut show = Show::start(&session, folder.path(), &["--hold", "0"]);
    show.event("swapped");
    wait_for("three windows that sway keeps awake", || {
        let tree = session.command("swaymsg").args(["-t", "get_tree", "-r"]).output().ok()?;
        (awake(&serde_json::from_slice(&tree.stdout).ok()?) == 3).then_some(())
    });
    show.quit();
}

#[test]
fn a_session_that_ends_ends_the_presentation() {
    let folder = tempfile::tempdir().unwrap();
    write_run(folder.path(), &display(&SWAY), 1);
    for options in [&[][..], &["--hold", "1"]] {
        let Some(mut session) = Session::sway(&SWAY) else { return };
        let mut show = Show::start(&session, folder.path(), options);
        show.event("swapped");
        session.end();
        let (status, errors) = show.ended();
        println!("{status}: {}", errors.trim());
        assert_eq!(status.code(), Some(1), "{status}: {errors}");
        assert!(errors.contains("the connection to the X server or the compositor was lost"), "{errors}");
    }
}

/// A sway on Xorg reports presentation times, from which the program computes late frames and the
/// skew between outputs.
#[test]
fn late_frames_and_skew_follow_from_reported_presentation_times() {
    let Some(session) = Session::sway_on_x(&ON_X) else { return };
    let folder = tempfile::tempdir().unwrap();
    write_run(folder.path(), &display(&ON_X), 1);
    let mut show = Show::start(&session, folder.path(), &["--duration-s", "4"]);
    show.event("started");
    let report = show.event("report");
    println!("{report}");
    for (name, ..) in ON_X {
        let shown = &report["presented"][name];
        assert!(shown["shown"].as_u64().unwrap() > 20, "{report}");
        assert_eq!(shown["out_of_order"], 0, "{report}");
    }
    // the skew of outputs of one server is below a second, even on a busy machine
    let skew = report["skew_mean_s"].as_f64().unwrap();
    assert!((0.0..1.0).contains(&skew), "{report}");
}

/// Without a window manager, a key press reaches the presentation, no matter which window had the
/// keyboard focus before.
#[test]
fn a_bare_x_server_sends_keys_to_the_presentation() {
    let Some(session) = Session::xorg(&XORG) else { return };
    let folder = tempfile::tempdir().unwrap();
    write_run(folder.path(), &display(&XORG), 1);
    let mut poke = poke::Poke::new(session.x_display());
    // place the pointer outside of the preview window, so that keys arrive only through the focus
    poke.point([1300, 300]);
    let (root, other) = (poke.root, poke.window());
    for options in [&["--hold", "1"][..], &["--span"], &["--preview"]] {
        for before in [poke::NOBODY, poke::POINTER_ROOT, root, other] {
            poke.focus(before);
            let mut show = Show::start(&session, folder.path(), options);
            show.event("started");
            poke.key(poke::ESCAPE);
            let (status, errors) = show.ended();
            assert!(status.success(), "{options:?} after {before}: {status}: {errors}");
        }
    }
    let mut show = Show::start(&session, folder.path(), &["--hold", "0"]);
    show.event("swapped");
    // with a window manager, the program does not set the focus itself
    poke.manage(true);
    poke.focus(root);
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(poke.focused(), root);
    poke.manage(false);
    // another window that takes the focus keeps it; when that window closes, the focus returns
    poke.focus(other);
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(poke.focused(), other);
    poke.close(other);
    wait_for("the keys", || (poke.focused() > 1).then_some(()));
    let (name, size, at) = XORG[0];
    wait_for("frame 0", || session.import().filter(|all| all.part(at, size) == expected(1, 0, 0, size)));
    // the first five keys shift the first panel; Tab selects the next panel, which the last key
    // shifts
    for key in [poke::RIGHT, poke::UP, poke::RIGHT, poke::UP, poke::RIGHT, poke::TAB, poke::DOWN] {
        poke.key(key);
    }
    let plain = expected(1, 0, 0, size).part([0, 2], [317, 238]);
    wait_for(&format!("the nudge on {name}"), || {
        session.import().filter(|all| all.part([at[0] + 3, at[1]], [317, 238]) == plain)
    });
    poke.key(poke::S);
    show.event("saved");
    let kept = Display::from_toml(&std::fs::read_to_string(folder.path().join("display.toml")).unwrap()).unwrap();
    let nudges = kept.layers.iter().map(|layer| layer.panel.as_ref().unwrap().nudge_px);
    assert_eq!(nudges.collect::<Vec<_>>(), [[3.0, -2.0], [0.0, 1.0], [0.0, 0.0]]);
    poke.key(poke::ESCAPE);
    assert!(show.ended().0.success());
}

/// Ends presentations in random ways and at random times, some before they have begun. They must
/// end without a crash. The variable `LUMISTACK_PANELS_TURNS` sets the number of presentations.
fn starts_and_stops(session: &Session, name: &str, turns: usize, key: &mut dyn FnMut(u32)) {
    let turns = std::env::var("LUMISTACK_PANELS_TURNS").ok().and_then(|turns| turns.parse().ok()).unwrap_or(turns);
    let folder = tempfile::tempdir().unwrap();
    write_run(folder.path(), &display(if name == "sway" { &ON_X } else { &XORG }), 1);
    let mut random = Stream::new(7);
    let mut ended = std::collections::BTreeMap::<String, usize>::new();
    for turn in 0..turns {
        let options = [&[][..], &["--hold", "1"], &["--span"], &["--preview"]][turn % 4];
        let mut show = Show::start(session, folder.path(), options);
        std::thread::sleep(Duration::from_secs_f32(1.5 * random.next_f32()));
        let way = ["quit", "interrupt", "terminate", "escape", "close"][(random.next_u64() % 5) as usize];
        // without a window manager, no program on Xorg can request that a window closes
        let way = if name == "Xorg" && way == "close" { "escape" } else { way };
        let signal = |name: &str, show: &Show| {
            assert!(session.command("kill").args([name, &show.child.id().to_string()]).status().unwrap().success());
        };
        match way {
            "quit" => show.tell("quit"),
            "interrupt" => signal("-INT", &show),
            "terminate" => signal("-TERM", &show),
            "close" if name == "sway" => {
                wait_for("the end by closing windows", || {
                    session.command("swaymsg").arg("[title=\"^lumistack\"] kill").output().unwrap();
                    show.child.try_wait().unwrap()
                });
            }
            // send the key again and again, since the window may not exist yet
            _ => {
                wait_for("the end by a key", || {
                    key(poke::ESCAPE);
                    show.child.try_wait().unwrap()
                });
            }
        }
        let (status, errors) = show.ended();
        // SIGTERM ends the program, which does not handle this signal. SIGINT also ends the program
        // by the signal, if it arrives before the handler is installed.
        let fine = match way {
            "interrupt" => matches!((status.code(), status.signal()), (Some(0 | 130), _) | (_, Some(2))),
            "terminate" => status.signal() == Some(15),
            _ => status.success(),
        };
        assert!(fine, "turn {turn}, {options:?}, {way}: {status}: {errors}");
        *ended.entry(format!("{way}: {status}")).or_default() += 1;
    }
    println!("{name}: {turns} presentations ended: {ended:?}");
}

#[test]
fn presentations_end_at_any_moment_without_a_crash() {
    let Some(session) = Session::xorg(&XORG) else { return };
    let mut poke = poke::Poke::new(session.x_display());
    poke.point([100, 100]);
    starts_and_stops(&session, "Xorg", 16, &mut |key| poke.key(key));
    drop(session);
    let Some(session) = Session::sway_on_x(&ON_X) else { return };
    let mut poke = poke::Poke::new(session.outer().x_display());
    poke.point([100, 100]);
    starts_and_stops(&session, "sway", 4, &mut |key| poke.key(key));
}

#[test]
fn without_a_session_there_is_one_error() {
    let mut command = common::lumistack();
    for key in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
        command.env_remove(key);
    }
    let text = common::fail(command.args(["show", "--list"]));
    assert!(text.contains("expected an X11 or Wayland session"), "{text}");
}
