//! Tests the rules of the plugin interface, the order of the views, and the parallax of the cards.

use lumistack_plugin::Time;
use lumistack_plugin::display::{Display, LightField};
use lumistack_plugin_test_views::PLUGIN;
use lumistack_plugin_testkit::serve::{Plugin, make_field};
use lumistack_plugin_testkit::{MemoryHost, conformance};

fn made(display: &Display, params: &str) -> LightField {
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    make_field(&plugin, &MemoryHost::new(), params, display, Time::default()).unwrap()
}

#[test]
fn it_conforms() {
    conformance(&PLUGIN).unwrap();
}

#[test]
fn every_view_has_its_own_number_and_colour() {
    let display = Display::uniform([48, 30], 1.0, [12, 3], [20.0, 10.0], &[-5.0, 5.0], 1);
    let field = made(&display, "{}");
    let views: Vec<[usize; 2]> = field.geometry().grid.iter().collect();
    for (i, a) in views.iter().enumerate() {
        assert!(views[..i].iter().all(|b| field.view(*a) != field.view(*b)), "{a:?} looks like another");
    }
    // The corners of a view show only the ground, whose colour depends on the view's position in
    // the grid.
    let corner = |view| [0, 1, 2].map(|channel: usize| field.view(view)[channel]);
    assert_eq!([corner([0, 0]), corner([0, 11]), corner([2, 0])], [[0.6, 0.4, 0.0], [0.0, 0.4, 0.6], [0.6, 0.0, 0.0]]);
    // The digits are in the middle of the view, and its first row shows only the ground.
    assert!(field.view([1, 5]).iter().any(|value| *value > 0.8));
    let edge = &field.view([1, 5])[..3 * 48];
    assert!(edge.chunks_exact(3).all(|pixel| pixel == &edge[..3]));
}

/// Between the views of slopes s' and s, a card at depth z must move by −z·(s − s'). The edges of
/// cards are found to whole pixels, so the tolerance is one pixel.
#[test]
fn cards_move_as_their_depth_says() {
    let (pitch, depth) = (0.5, 12.0);
    let display = Display::uniform([300, 60], pitch, [3, 1], [30.0, 10.0], &[-5.0, 5.0], 1);
    let field = made(&display, r#"{"pattern": "cards", "depth_mm": 12.0, "squares": 1}"#);
    let geometry = field.geometry();
    // Returns the left and the right edge of the card in a third of the picture, found in pixel row
    // 30. This row crosses bright squares of the card.
    let edges = |view: usize, third: usize| -> [f64; 2] {
        let row = &field.view([0, view])[3 * 300 * 30..3 * 300 * 31];
        let level = |col: usize| f64::from(row[3 * col..3 * col + 3].iter().sum::<f32>());
        let wall = level(0);
        let cover: Vec<usize> =
            (100 * third..100 * (third + 1)).filter(|col| (level(*col) - wall).abs() > 0.05).collect();
        [*cover.first().unwrap() as f64, *cover.last().unwrap() as f64]
    };
    for (third, z) in [-depth, 0.0, depth].into_iter().enumerate() {
        for view in [0, 2] {
            let expected = -z * (geometry.grid.slope_x[view] - geometry.grid.slope_x[1]) / pitch;
            for (edge, middle) in edges(view, third).into_iter().zip(edges(1, third)) {
                assert!((edge - middle - expected).abs() <= 1.0, "z {z}, view {view}: {edge} {middle} {expected}");
            }
        }
    }
}
