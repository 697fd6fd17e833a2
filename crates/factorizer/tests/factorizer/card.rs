//! Tests a target that shows a textured card at the position of a layer: the texture must appear on
//! that layer.

use lumistack_core::Cancel;
use lumistack_display::LayerStack;

use crate::problems::{Owned, display};
use lumistack_factorizer::{Multiplicative, Solver, random_start};

/// Returns the light field of a card at z = `d_mm` in closed form: L(x, s) = texture(x + d·s).
fn card(d_mm: f64) -> Owned {
    let mut display = display([48, 36], [5, 5], &[-12.0, 0.0, 12.0], 4);
    display.brightness = 0.3;
    let mut owned = Owned::constant(display, 0.0);
    let field = owned.target.geometry().clone();
    // a product of waves of 3 to 5 pixels
    let texture = |x: f64, y: f64| 0.5 + 0.4 * (2.1 * x + 0.3 * y).sin() * (1.3 * y - 0.2 * x).cos();
    for view in field.grid.iter() {
        let [sx, sy] = field.grid.slope_at(view, [0.0, 0.0]);
        let pixels = owned.target.view_mut(view);
        for (i, pixel) in pixels.chunks_exact_mut(3).enumerate() {
            let (x, y) = (field.x_mm(i % field.cols), field.y_mm(i / field.cols));
            pixel.fill(texture(x + d_mm * sx, y + d_mm * sy) as f32);
        }
    }
    owned
}

/// Returns the energy of the fine detail of layer `n`: squared horizontal differences of the
/// logarithm of its mean transmittance over frames, away from the border.
fn high_frequency_energy(stack: &LayerStack, n: usize) -> f64 {
    let layer = &stack.layers[n];
    let [frames, rows, cols, _] = layer.shape();
    let log = |row: usize, col: usize| {
        ((0..frames).map(|m| f64::from(layer.get([m, row, col, 1]))).sum::<f64>() / frames as f64).ln()
    };
    let mut energy = 0.0;
    for row in 4..rows - 4 {
        for col in 4..cols - 4 {
            energy += (log(row, col + 1) - log(row, col)).powi(2);
        }
    }
    energy
}

#[test]
fn a_textured_card_goes_to_the_layer_where_it_stands() {
    for (n, d_mm) in [-12.0, 0.0, 12.0].into_iter().enumerate() {
        let owned = card(d_mm);
        let mut run = Multiplicative.start(&owned.problem(), random_start(&owned.display, 3)).unwrap();
        for _ in 0..100 {
            run.step(&Cancel::default()).unwrap();
        }
        let stack = run.download();
        let energies: Vec<f64> = (0..3).map(|n| high_frequency_energy(&stack, n)).collect();
        let share = energies[n] / energies.iter().sum::<f64>();
        println!(
            "card at {d_mm} mm: shares {energies:.1?}, {share:.2} on layer {n}; {:.1} dB",
            run.objective().psnr_view
        );
        assert!(share > 0.5, "card at {d_mm} mm: {energies:?}");
    }
}
