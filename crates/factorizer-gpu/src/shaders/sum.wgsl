// Layers emit: the emission of frame m is the sum of all factors, so its derivative by the own
// factor is a_m = 1.
//@ frames
let a{m} = 1.0;
//@ if own
emitted += own{m};
//@ end
//@ others
emitted += read_{k}(line_of_{k}, column_of_{k}, {m}u);
//@ end
//@ end
