// Layers attenuate: a_m is the product of all other factors, Π_{k ≠ own} f_k, in frame m. The
// emission of frame m is a_m times the own factor. In errors.wgsl no factor is the own factor, and
// a_m is the emission.
//@ frames
var a{m} = 1.0;
//@ end
//@ others
//@ frames
a{m} *= read_{k}(line_of_{k}, column_of_{k}, {m}u);
//@ end
//@ end
//@ frames
//@ if own
emitted += a{m} * own{m};
//@ end
//@ if !own
emitted += a{m};
//@ end
//@ end
