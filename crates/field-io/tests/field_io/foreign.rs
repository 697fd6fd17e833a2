//! Light fields of other renderers: order of views, direction of parallax, geometry.

use std::fs;
use std::path::Path;

use crate::common::{assets, defaults, open, save_png};
use lumistack_core::colour::{luminance, srgb_decode};
use lumistack_display::{LightField, Projection, ViewGrid};
use lumistack_field_io::{GeometryDefaults, GeometryFlags, describe};

/// Tolerance of decoded code values.
const CODE: f32 = 1e-6;
/// Tolerance of slopes from files with 17 digits, after a few operations.
const EXACT: f64 = 1e-12;

/// Saves a picture with the view's column in red, its row in green, and the pixel column in blue.
fn labelled(path: &Path, label: [u8; 2]) {
    save_png(path, [6, 4], |x, _| [label[0], label[1], 10 * x as u8]);
}

fn label(field: &LightField, view: [usize; 2]) -> [u8; 2] {
    let pixel = field.view(view);
    [0, 1].map(|channel| {
        (0..=255u8)
            .min_by_key(|&code| ((srgb_decode(f32::from(code) / 255.0) - pixel[channel]).abs() * 1e7) as u64)
            .unwrap()
    })
}

#[test]
fn stanford_views_are_ordered_by_camera_centres() {
    for (x_sign, y_sign) in [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)] {
        let folder = tempfile::tempdir().unwrap();
        for row in 0..2u8 {
            for col in 0..3u8 {
                // the cameras are unevenly spaced along x, at 0, 10 and 40
                let x = x_sign * [0.0, 10.0, 40.0][usize::from(col)] + 500.0;
                let y = y_sign * 20.0 * f64::from(row);
                labelled(&folder.path().join(format!("out_{row:02}_{:02}_{y:.6}_{x:.6}_.png", 4 * col)), [col, row]);
            }
        }
        let (field, warnings) = open(folder.path(), &GeometryFlags::default(), &defaults());
        let field = field.unwrap();
        let leftmost = if x_sign > 0.0 { 0 } else { 2 };
        let topmost = if y_sign > 0.0 { 0 } else { 1 };
        assert_eq!(label(&field, [0, 0]), [leftmost, topmost]);
        assert_eq!(label(&field, [1, 2]), [2 - leftmost, 1 - topmost]);
        // the three bins together cover 20°, so `step` is their mean width; the slopes are in
        // proportion to the cameras' positions
        let step = 2.0 / 3.0 * 10f64.to_radians().tan();
        let expected = if x_sign > 0.0 { [-1.0, -0.5, 1.0] } else { [-1.0, 0.5, 1.0] };
        for (slope, expected) in field.geometry().grid.slope_x.iter().zip(expected) {
            assert!((slope - step * expected).abs() < EXACT, "{:?}", field.geometry().grid.slope_x);
        }
        assert!(field.geometry().grid.slope_y[0] > 0.0);
        assert!(warnings.iter().any(|w| w.contains("--fov")) && warnings.iter().any(|w| w.contains("--pitch-mm")));
        let flags = GeometryFlags { mirror: [true, false], ..GeometryFlags::default() };
        assert_eq!(label(&open(folder.path(), &flags, &defaults()).0.unwrap(), [0, 0]), [2 - leftmost, topmost]);
    }
}

#[test]
fn numbered_and_hci_views_go_from_the_top_left() {
    let folder = tempfile::tempdir().unwrap();
    for (row, col) in [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)] {
        labelled(&folder.path().join(format!("{row:02}_{col:02}.png")), [col, row]);
    }
    // disparity maps next to the views are ignored
    save_png(&folder.path().join("disparity_00_00.png"), [3, 3], |_, _| [0; 3]);
    let (field, warnings) = open(folder.path(), &GeometryFlags::default(), &defaults());
    let field = field.unwrap();
    assert_eq!((label(&field, [0, 2]), label(&field, [1, 0])), ([2, 0], [0, 1]));
    let uniform = ViewGrid::uniform(Projection::Oblique, [3, 2], [20.0, 20.0]).unwrap();
    assert!(field.geometry().grid.slope_x.iter().zip(&uniform.slope_x).all(|(a, b)| (a - b).abs() < EXACT));
    assert!(warnings.iter().any(|w| w.contains("only pictures without a prefix are read")), "{warnings:?}");

    let folder = tempfile::tempdir().unwrap();
    for index in 0..6u8 {
        labelled(&folder.path().join(format!("input_Cam{index:03}.png")), [index % 3, index / 3]);
    }
    fs::write(
        folder.path().join("parameters.cfg"),
        "[intrinsics]\nfocal_length_mm = 100.0\nsensor_size_mm = 35.0\n[extrinsics]\nnum_cams_x = 3\nnum_cams_y = 2\nbaseline_mm = 50.0\nfocus_distance_m = 10.0\n",
    )
    .unwrap();
    let (field, warnings) = open(folder.path(), &GeometryFlags::default(), &defaults());
    assert_eq!(label(&field.unwrap(), [1, 2]), [2, 1]);
    assert!(
        warnings.iter().any(|w| w.contains("the cameras of the views were spread over 0.9° × 0.6°")),
        "{warnings:?}"
    );
    // Without a default angle, a view's slope is its camera's offset from the centre divided by the
    // focus distance: the steps are 50 mm / 10 m. The viewing distance is the light field's width ·
    // focal length / sensor width.
    let own = GeometryDefaults { width_mm: Some(350.0), fov_deg: None };
    let field = open(folder.path(), &GeometryFlags::default(), &own).0.unwrap();
    let grid = &field.geometry().grid;
    assert!(grid.slope_x.iter().zip([-0.005, 0.0, 0.005]).all(|(a, b)| (a - b).abs() < EXACT), "{grid:?}");
    assert!(grid.slope_y.iter().zip([0.0025, -0.0025]).all(|(a, b)| (a - b).abs() < EXACT), "{grid:?}");
    let Projection::Perspective { distance_mm } = grid.projection else { panic!("{grid:?}") };
    assert!((distance_mm - 1000.0).abs() < 1e-9);
    // a picture of a seventh camera is not read, and a warning names it
    labelled(&folder.path().join("input_Cam006.png"), [0, 0]);
    let (field, warnings) = open(folder.path(), &GeometryFlags::default(), &defaults());
    assert_eq!(label(&field.unwrap(), [1, 2]), [2, 1]);
    let expected = "expected 3 × 2 cameras, as in parameters.cfg, found more; further pictures are not read (number: 1; first: input_Cam006.png)";
    assert!(warnings.iter().any(|w| w.ends_with(expected)), "{warnings:?}");
}

#[test]
fn quilts_start_at_the_bottom_left_and_may_be_anamorphic() {
    let folder = tempfile::tempdir().unwrap();
    // the picture has 3 × 2 tiles of 6 × 4 pixels; one column at the right and one row at the top
    // are unused
    let draw =
        |name: &str| {
            let path = folder.path().join(name);
            save_png(&path, [19, 9], |x, y| {
                if x < 18 && y > 0 { [(x / 6) as u8, 1 - ((y - 1) / 4) as u8, 0] } else { [99; 3] }
            });
            path
        };
    let field = open(&draw("a_qs3x2a1.5.png"), &GeometryFlags::default(), &defaults()).0.unwrap();
    assert_eq!(field.radiance().shape(), [1, 6, 4, 6, 3]);
    assert_eq!([0, 2, 3, 5].map(|view| label(&field, [0, view])), [[0, 0], [2, 0], [0, 1], [2, 1]]);
    assert!(field.geometry().grid.slope_x.windows(2).all(|pair| pair[1] > pair[0]));
    assert_eq!(field.geometry().grid.slope_y, [0.0]);
    assert!((field.geometry().pitch_mm - 400.0 / 6.0).abs() < EXACT);
    // a view has the aspect 3 : 4, so square pixels reduce its six columns to three
    let field = open(&draw("a_qs3x2a0.75.png"), &GeometryFlags::default(), &defaults()).0.unwrap();
    assert_eq!(field.radiance().shape(), [1, 6, 4, 3, 3]);
    // the flag overrides the layout in the name, and gives a layout to a picture without one
    let flags = GeometryFlags { quilt: Some([2, 3]), ..GeometryFlags::default() };
    assert_eq!(open(&draw("a_qs3x2.png"), &flags, &defaults()).0.unwrap().radiance().shape(), [1, 6, 3, 9, 3]);
    let flags = GeometryFlags { tiles: Some([19, 9]), ..GeometryFlags::default() };
    let field = open(&draw("plain.png"), &flags, &defaults()).0.unwrap();
    assert_eq!(field.radiance().shape(), [9, 19, 1, 1, 3]);
    assert_eq!((label(&field, [1, 0]), label(&field, [8, 17])), ([0, 1], [2, 0]));
}

/// Returns the shift along an axis, in pixels, at which two views match best.
fn best_shift(field: &LightField, first: [usize; 2], second: [usize; 2], axis: usize, reach: i64) -> i64 {
    let [_, _, rows, cols, _] = field.radiance().shape();
    let level = |view: [usize; 2], row: i64, col: i64| {
        let pixel = &field.view(view)[3 * (row as usize * cols + col as usize)..];
        luminance([pixel[0], pixel[1], pixel[2]]).sqrt()
    };
    let error = |shift: i64| -> f64 {
        let (dr, dc) = if axis == 0 { (0, shift) } else { (shift, 0) };
        let mut sum = 0.0;
        for row in reach..rows as i64 - reach {
            for col in reach..cols as i64 - reach {
                sum += f64::from((level(first, row, col) - level(second, row + dr, col + dc)).abs());
            }
        }
        sum
    };
    (-reach..=reach).min_by(|&a, &b| error(a).total_cmp(&error(b))).unwrap()
}

/// The shop's cameras are parallel. As the viewpoint moves right, all content moves left, by 2 to
/// 14 pixels per view at full resolution.
#[test]
fn the_shop_has_its_parallax_the_right_way_round() {
    let Some(path) = assets("LUMISTACK_ASSETS", "scenes", "lightfields/shop-9x9") else { return };
    let flags = GeometryFlags {
        resolution: Some([240, 160]),
        views: Some([3, 3]),
        focus_px: Some(0.0),
        ..GeometryFlags::default()
    };
    let field = open(&path, &flags, &defaults()).0.unwrap();
    assert_eq!(field.radiance().shape(), [3, 3, 160, 240, 3]);
    // kept views are four views apart, at a quarter of the resolution, so content again moves by 2
    // to 14 pixels
    let across = best_shift(&field, [1, 0], [1, 1], 0, 20);
    let down = best_shift(&field, [0, 1], [1, 1], 1, 20);
    assert!((-14..=-2).contains(&across), "viewpoint to the right: content moves by {across}");
    assert!((-14..=-2).contains(&down), "viewpoint down: content moves by {down} rows");
}

#[test]
fn the_shop_is_put_in_focus_and_can_keep_its_own_angles() {
    let Some(path) = assets("LUMISTACK_ASSETS", "scenes", "lightfields/shop-9x9") else { return };
    let flags = GeometryFlags { views: Some([3, 3]), resolution: Some([180, 112]), ..GeometryFlags::default() };
    let (field, warnings) = open(&path, &flags, &GeometryDefaults { width_mm: Some(400.0), fov_deg: None });
    let field = field.unwrap();
    println!("{warnings:#?}");
    assert!(warnings.iter().any(|w| w.contains("is moved to z = 0")), "{warnings:?}");
    // The plane that was moved to z = 0 had a disparity of 9 ± 3 pixels per view. The focal length
    // is 800 pixels, and kept views are four views apart, so their slopes differ by 4 · (9 ±
    // 3)/800.
    let grid = &field.geometry().grid;
    assert!((6.0 / 800.0 * 4.0..12.0 / 800.0 * 4.0).contains(&grid.slope_x[2]), "{grid:?}");
    assert!((grid.slope_x[2] - grid.slope_y[0]).abs() < EXACT);
    assert!(matches!(grid.projection, Projection::Perspective { .. }));
    // after focusing, content moves both ways and content of middle depth stays in place
    let across = best_shift(&field, [1, 0], [1, 1], 0, 12);
    assert!(across.abs() <= 3, "{across}");
}

#[test]
fn the_real_quilt_has_thirty_two_views() {
    let Some(path) = assets("LUMISTACK_ASSETS", "scenes", "lightfields/quilt-4x8-solids/example02.png") else { return };
    let flags = GeometryFlags { quilt: Some([4, 8]), ..GeometryFlags::default() };
    let (field, _) = open(path.parent().unwrap(), &flags, &defaults());
    let field = field.unwrap();
    assert_eq!(field.radiance().shape(), [1, 32, 256, 512, 3]);
    // from view 8 to view 24 the box in front moves left, and the background stays
    let across = best_shift(&field, [0, 8], [0, 24], 0, 16);
    println!("from view 8 to view 24 the picture moves by {across}");
    assert!(across <= 0);
    let corner = |view: usize| field.view([0, view])[0];
    assert!((corner(0) - corner(31)).abs() < CODE);
}

#[test]
fn shared_arrays_carry_their_geometry_beside_them() {
    for (name, views) in [("main_5x5_160x100_fov20", 5), ("teapot_3x3_160x100_fov20", 3)] {
        let Some(path) = assets("LUMISTACK_LIGHTFIELDS", "lightfields", &format!("{name}.npy")) else { return };
        let (field, warnings) = open(&path, &GeometryFlags::default(), &GeometryDefaults::default());
        let field = field.unwrap();
        assert_eq!(field.radiance().shape(), [views, views, 100, 160, 3]);
        assert_eq!(field.geometry().pitch_mm, 2.961);
        let grid = ViewGrid::uniform(Projection::Oblique, [views, views], [20.0, 20.0]).unwrap();
        let found = &field.geometry().grid;
        let pairs = found.slope_x.iter().chain(&found.slope_y).zip(grid.slope_x.iter().chain(&grid.slope_y));
        assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < EXACT), "{found:?}");
        assert_eq!(found.projection, Projection::Oblique);
        assert!(warnings.is_empty(), "{warnings:?}");
        let (collector, cancel) = (lumistack_core::Collector::default(), lumistack_core::Cancel::default());
        let task = lumistack_core::Task::quiet(&collector, &cancel);
        let summary = describe(&path, &GeometryFlags::default(), task).unwrap();
        assert_eq!((summary.views, summary.resolution, summary.not_finite), ([views, views], [160, 100], 0));
        assert!(summary.minimum >= 0.0 && summary.maximum > 0.3, "{summary:?}");
    }
}
