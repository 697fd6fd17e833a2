use lumistack_core::{Cancel, Cancelled};
use lumistack_display::Display;

use super::fields::{CONTENTS, Content, display, target};
use crate::motion::{Flow, Planes, moved};

/// Returns the planes of content that is moved to the right.
fn planes(display: &Display, content: Content, moved_mm: f64) -> Planes {
    Planes::of(display, &target(display, content, moved_mm, 0).field, &Cancel::default()).unwrap()
}

fn flows([before, after]: &[Planes; 2]) -> Option<Vec<Flow>> {
    before.flows_to(after, &Cancel::default()).unwrap()
}

#[test]
fn content_that_moves_is_found_on_every_layer_and_patterns_move_with_it() {
    let display = display();
    for content in CONTENTS {
        for shift in [0, 2, 7, 10] {
            let Some(flows) = flows(&[0.0, f64::from(shift)].map(|by| planes(&display, content, by))) else {
                assert_eq!(shift, 0, "{content:?}");
                continue;
            };
            for flow in &flows {
                // New content enters across the border and matches nothing, so compare only pixels
                // away from the border.
                let inner: Vec<[i32; 2]> = (12..38)
                    .flat_map(|row| (24..68).map(move |col| [row, col]))
                    .map(|[row, col]| flow.at(row, col))
                    .collect();
                let right = inner.iter().filter(|found| **found == [shift, 0]).count();
                let share = right as f64 / inner.len() as f64;
                assert!(share > 0.9, "{content:?} {shift}: {share}");
            }
        }
    }
}

/// The value of a pixel is the pixel's index, so a moved value shows the pixel that it came from.
#[test]
fn values_move_by_whole_pixels_in_every_frame() {
    let display = display();
    let flows = flows(&[0.0, 6.0].map(|by| planes(&display, CONTENTS[1], by))).unwrap();
    let mut stack = lumistack_display::LayerStack::filled(&display, 0.0);
    for layer in &mut stack.layers {
        layer.data_mut().iter_mut().enumerate().for_each(|(i, value)| *value = i as f32);
    }
    let fresh = lumistack_display::LayerStack::filled(&display, -1.0);
    let out = moved(&stack, &flows, &fresh);
    for (layer, before) in out.layers.iter().zip(&stack.layers) {
        assert_eq!(layer.get([1, 25, 2, 1]), -1.0, "a value from outside the layer is fresh");
        for (frame, channel) in [(0, 0), (3, 2)] {
            assert_eq!(layer.get([frame, 25, 40, channel]), before.get([frame, 25, 34, channel]));
        }
    }
}

#[test]
fn displays_that_differ_have_no_motion_between_them() {
    let mut other = display();
    other.layers.pop();
    assert_eq!(flows(&[display(), other].map(|display| planes(&display, CONTENTS[0], 0.0))), None);
}

#[test]
fn the_motion_is_the_same_on_any_number_of_threads_and_can_be_cancelled() {
    let display = display();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let planes = [0.0, 7.0].map(|by| planes(&display, Content::Two, by));
            (flows(&planes), planes)
        })
    };
    let (flows, [before, after]) = on(1);
    assert!(flows.is_some());
    assert_eq!(on(3), (flows, [before.clone(), after.clone()]));
    let cancel = Cancel::default();
    cancel.cancel();
    assert_eq!(before.flows_to(&after, &cancel), Err(Cancelled));
    let field = &target(&display, Content::Two, 0.0, 0).field;
    assert_eq!(Planes::of(&display, field, &cancel), Err(Cancelled));
}
