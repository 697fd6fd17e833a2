// Squares the errors e = βL − L̃ of one field pixel, and sums them over all views. Returns Σ w e²,
// and Σ e² over the rays with a weight w > 0. The factorizer's errors.rs computes the same sums.

fn errors_of(row: u32, col: u32) -> vec2<f32> {
    var found = vec2<f32>(0.0);
    for (var view_y = 0u; view_y < params.views_y; view_y++) {
        if (tables[params.counted_rows + view_y * params.rows + row] == 0u) {
            continue;
        }
//@ others
        let line_of_{k} = line_{k}(view_y, row);
//@ end
        for (var view_x = 0u; view_x < params.views_x; view_x++) {
            if (tables[params.counted_cols + view_x * params.cols + col] == 0u) {
                continue;
            }
            let view = view_y * params.views_x + view_x;
//@ others
            let column_of_{k} = column_{k}(view_x, col);
//@ end
            var emitted = 0.0;
//@ include coefficients
            let e = wanted_of(view, row, col) - emitted * MEAN;
            let root = root_of(view, row, col);
            found += vec2<f32>(root * e * root * e, select(0.0, e * e, root > 0.0));
        }
    }
    return found;
}

@compute @workgroup_size(64)
fn main(thread: Thread) {
    let id = thread.id;
    var found = vec2<f32>(0.0);
    if (id.x < params.cols && id.y < params.count) {
        found = errors_of(params.first + id.y, id.x);
    }
    reduce(thread, found);
}
