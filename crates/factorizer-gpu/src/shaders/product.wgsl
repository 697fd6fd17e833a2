// Layers attenuate: a_m = Π_{k ≠ own} f_k.
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
