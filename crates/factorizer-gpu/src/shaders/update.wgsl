// The update of one factor: sums over the rays through a pixel, and the step that follows from
// these sums. The factorizer's sums.rs and step.rs compute the same update.

const LEAST_CURVATURE: f32 = 1e-30;
const LEAST_NORMAL: f32 = 1.17549435e-38;

// Returns Σ w e² before the step, and the gain of the step as the factorizer's `Outcome` defines
// it.
fn update_pixel(line: u32, column: u32) -> vec2<f32> {
    let views = params.views_y * params.views_x;
    let length = FRAMES * params.own_cols;
//@ frames
    let f{m} = values_{own}[line * length + {m}u * params.own_cols + column - params.base_{own}];
//@ end
    var error = 0.0;
    var light = 0.0;
//@ sums
    var {s} = 0.0;
//@ end
    // The tables list the rays through the pixel: the field rows that read its line, and the field
    // columns that read its column. Each row and column has its weight in the interpolation.
    for (var view_y = 0u; view_y < params.views_y; view_y++) {
        let lines_at = params.own_lines + view_y * (params.stored_lines + 1u) + line;
        let last_row = tables[lines_at + 1u];
        for (var of_row = tables[lines_at]; of_row < last_row; of_row += 2u) {
            let row = tables[of_row];
            let row_share = bitcast<f32>(tables[of_row + 1u]);
//@ others
            let line_of_{k} = line_{k}(view_y, row);
//@ end
//@ if mixed
            let line_of_{own} = line_{own}(view_y, row);
//@ end
//@ if long_sums
            // If there are many rays, sum those of each field row first. Additions to a smaller sum
            // lose fewer digits.
//@ sums
            let before_{s} = {s};
            {s} = 0.0;
//@ end
//@ end
            for (var view_x = 0u; view_x < params.views_x; view_x++) {
                let columns_at = params.own_columns + view_x * (params.own_cols + 1u) + column;
                let last_col = tables[columns_at + 1u];
                for (var of_col = tables[columns_at]; of_col < last_col; of_col += 2u) {
                    let col = tables[of_col];
                    let view = view_y * params.views_x + view_x;
                    let root = root_of(view, row, col);
                    let share = row_share * bitcast<f32>(tables[of_col + 1u]) * root * root;
//@ others
                    let column_of_{k} = column_{k}(view_x, col);
//@ end
//@ if mixed
                    let column_of_{own} = column_{own}(view_x, col);
//@ end
//@ frames
//@ if mixed
                    let own{m} = read_{own}(line_of_{own}, column_of_{own}, {m}u);
//@ end
//@ if !mixed
                    let own{m} = f{m};
//@ end
//@ end
                    var emitted = 0.0;
//@ include coefficients
                    emitted *= MEAN;
                    let wanted = wanted_of(view, row, col);
                    let e = wanted - emitted;
                    error += share * e * e;
                    light += share;
//@ if ratio
//@ frames
                    n{m} += share * wanted * a{m};
                    d{m} += share * emitted * a{m};
//@ end
//@ end
//@ if !ratio
//@ frames
                    r{m} += share * e * a{m};
//@ end
//@ if products
//@ pairs
                    g{m}_{j} += share * a{m} * a{j};
//@ end
//@ end
//@ if nonlinear
                    // L̃ is not linear in the factor's values, so add a bound of the objective's
                    // curvature.
//@ if local
                    let most = LOCAL_CURVATURE * abs(e);
//@ end
//@ if !local
                    let most = CURVATURE * (1.0 + 2.0 * max(abs(wanted), abs(1.0 - wanted)));
//@ end
//@ frames
                    g{m}_{m} += share * most;
//@ end
//@ end
//@ end
                }
            }
//@ if long_sums
//@ sums
            {s} += before_{s};
//@ end
//@ end
        }
    }
    // compute the step from the values f to the new values v, by the rule of the update
    var gain = 0.0;
//@ frames
    var v{m} = f{m};
//@ end
//@ if ratio
//@ frames
    if (d{m} >= LEAST_NORMAL) {
        v{m} = clamp(f{m} * (n{m} / d{m}), params.low, params.high);
    }
//@ end
//@ end
//@ if gram
    // Coordinate descent: the value of one frame after another moves to the minimum of the
    // objective, clamped to low..high.
//@ frames
    let inverse{m} = f32(FRAMES) / max(g{m}_{m}, LEAST_CURVATURE);
    let before{m} = r{m};
//@ end
    var moved = 0.0;
    var change = 0.0;
    for (var sweep = 0u; sweep < params.sweeps; sweep++) {
//@ frames
        moved = clamp(v{m} + r{m} * inverse{m}, params.low, params.high);
        change = (moved - v{m}) * MEAN;
        v{m} = moved;
//@ row
        r{j} -= {g} * change;
//@ end
//@ end
    }
//@ frames
    gain += (before{m} + r{m}) * (v{m} - f{m}) * MEAN;
//@ end
//@ end
//@ if diagonal
    // These steps are computed only for the KKT residual; they do not change the values.
    var curvature = 0.0;
    var step = 0.0;
//@ frames
    curvature = max(g{m}_{m}, LEAST_CURVATURE);
    step = (clamp(f{m} + r{m} * f32(FRAMES) / curvature, params.low, params.high) - f{m}) * MEAN;
    gain += step * step * curvature;
//@ end
//@ end
//@ if darken
    let limit = select(-1.0, light * params.unlit, light > 0.0);
//@ frames
    if (g{m}_{m} <= limit) {
        v{m} = params.low;
    }
//@ end
//@ end
//@ if moves
    // write the new values, and the extrapolated ones if requested
    let place = line * length + column - params.out_base;
//@ if extrapolated
    var at = place;
    var past = 0.0;
//@ frames
    past = latest[at];
    latest[at] = v{m};
    stepped[at] = clamp(v{m} + params.extrapolation * (v{m} - past), params.low, params.high);
    at += params.own_cols;
//@ end
//@ end
//@ if !extrapolated
//@ frames
    stepped[place + {m}u * params.own_cols] = v{m};
//@ end
//@ end
//@ end
    return vec2<f32>(error, gain);
}

@compute @workgroup_size(64)
fn main(thread: Thread) {
    let id = thread.id;
    var found = vec2<f32>(0.0);
    if (id.x < params.own_cols && id.y < params.count) {
        found = update_pixel(params.first + id.y, id.x);
    }
    reduce(thread, found);
}
