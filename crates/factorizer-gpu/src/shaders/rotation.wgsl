// Layers rotate polarization. With s the sum of all layers and b the value of the backlight, the
// emission of frame m is b sin²((π/2) s). Let a_m be its derivative by the own factor. For a layer
// a_m = b (π/2) sin(π s), and for the backlight a_m = sin²((π/2) s).
//@ frames
var turn{m} = 0.0;
var light{m} = 1.0;
//@ if own
//@ if backlight
light{m} = own{m};
//@ end
//@ if !backlight
turn{m} = own{m};
//@ end
//@ end
//@ layers
turn{m} += read_{k}(line_of_{k}, column_of_{k}, {m}u);
//@ end
//@ lights
light{m} = read_{k}(line_of_{k}, column_of_{k}, {m}u);
//@ end
let wave{m} = wave(turn{m});
emitted += light{m} * wave{m}.x * wave{m}.x;
//@ if backlight
let a{m} = wave{m}.x * wave{m}.x;
//@ end
//@ if !backlight
let a{m} = light{m} * 3.14159265358979 * wave{m}.x * wave{m}.y;
//@ end
//@ end
