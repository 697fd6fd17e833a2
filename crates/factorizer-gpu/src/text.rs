//! Generates the text of shaders. In the source of a shader, a block that is repeated for every
//! factor or frame is written once.
//!
//! ```text
//! //@ factors   all factors, {k}             //@ frames   {m} = 0 .. M
//! //@ others    all but the own factor       //@ pairs    {m} ≤ {j}, or {m} = {j} without G
//! //@ layers    the layers among them        //@ row      within frames: all {j}, with
//! //@ lights    the backlight among them                  {g} = g{m}_{j} of the upper triangle
//! //@ if FLAG, //@ if !FLAG                  //@ sums     the sums {s} that the rule needs
//! //@ include coefficients
//! ```
//!
//! Each block ends at its `//@ end`. The own factor is the factor that the shader updates. N and M
//! are constants of the generated shader, so its loops over frames and factors are unrolled, and
//! sums stay in registers.

use std::fmt::Write;

use lumistack_display::Formation;
use lumistack_factorizer::device::{Plan, Rule};

const READ: &str = include_str!("shaders/read.wgsl");
const UPDATE: &str = include_str!("shaders/update.wgsl");
const ERRORS: &str = include_str!("shaders/errors.wgsl");

/// Number of bindings in front of the factors' bindings.
pub(crate) const FIRST_FACTOR: usize = 7;

/// The properties on which the text of a shader depends.
pub(crate) struct Program<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) weighted: bool,
    /// Number of results of a workgroup, one per subgroup; 1 without subgroups.
    pub(crate) parts: usize,
    /// The update of a factor; `None` for the shader that computes errors.
    pub(crate) update: Option<Update>,
}

/// An update of a factor.
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct Update {
    pub(crate) own: usize,
    pub(crate) rule: Rule,
    pub(crate) extrapolated: bool,
    /// True if the update uses the curvature at the current values instead of a bound of the
    /// curvature. The two differ only if L̃ is not linear in the values.
    pub(crate) local: bool,
}

impl Program<'_> {
    /// Generates the program in WGSL.
    pub(crate) fn text(&self) -> String {
        let plan = self.plan;
        // constants of the problem
        let mut text = String::new();
        let _ = writeln!(text, "const FRAMES: u32 = {}u;", plan.frames());
        let _ = writeln!(text, "const MEAN: f32 = {:?};", 1.0 / plan.frames() as f32);
        let quarter = std::f64::consts::FRAC_PI_2.powi(2) * plan.frames() as f64;
        let _ = writeln!(text, "const CURVATURE: f32 = {quarter:?};");
        let _ = writeln!(text, "const LOCAL_CURVATURE: f32 = {:?};", 2.0 * quarter);
        let _ = writeln!(text, "const HALF: bool = {};", plan.has_half_target());
        let _ = writeln!(text, "const WEIGHTED: bool = {};", self.weighted);
        let _ = writeln!(text, "const PARTS: u32 = {}u;", self.parts);
        for k in 0..plan.factor_count() {
            let _ = writeln!(text, "const MIXED_{k}: bool = {};", !plan.is_nearest(k));
            let _ = writeln!(text, "const OUTSIDE_{k}: f32 = {:?};", plan.outside(k));
        }
        // the shader itself
        let place = Place::default();
        for file in [READ, if self.update.is_some() { UPDATE } else { ERRORS }] {
            self.expand(&mut file.lines(), &place, &mut text);
        }
        text
    }

    fn is(&self, flag: &str) -> bool {
        let (plan, update) = (self.plan, self.update);
        if flag == "subgroups" {
            return self.parts > 1;
        }
        let Some(Update { own, rule, extrapolated, local }) = update else { return false };
        let nonlinear = !plan.is_bounded(own) && rule != Rule::Multiplicative;
        match flag {
            "own" => true,
            "backlight" => own >= plan.layer_count(),
            "mixed" => !plan.is_nearest(own),
            "long_sums" => !plan.has_short_sums(own),
            "ratio" => rule == Rule::Multiplicative,
            "gram" => matches!(rule, Rule::Block { .. }),
            "diagonal" => matches!(rule, Rule::KktResidual | Rule::Darken),
            "darken" => rule == Rule::Darken,
            "moves" => rule != Rule::KktResidual,
            "products" => !nonlinear || local,
            "nonlinear" => nonlinear,
            "local" => local,
            "extrapolated" => extrapolated,
            _ => unreachable!("flag {flag} of a shader"),
        }
    }

    /// Returns the names of the sums that the rule needs.
    fn sums(&self) -> Vec<String> {
        let frames = 0..self.plan.frames();
        if self.is("ratio") {
            return frames.flat_map(|m| [format!("n{m}"), format!("d{m}")]).collect();
        }
        frames.clone().map(|m| format!("r{m}")).chain(self.pairs().map(|(m, j)| format!("g{m}_{j}"))).collect()
    }

    /// Returns the pairs of frames (m, j) whose products a_m a_j the shader sums.
    fn pairs(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let (frames, gram) = (self.plan.frames(), self.is("gram"));
        (0..frames).flat_map(move |m| (m..if gram { frames } else { m + 1 }).map(move |j| (m, j)))
    }

    /// Expands lines up to the `//@ end` of their block, or up to the last line.
    fn expand(&self, lines: &mut dyn Iterator<Item = &str>, place: &Place, to: &mut String) {
        while let Some(line) = lines.next() {
            let Some(directive) = line.trim_start().strip_prefix("//@ ") else {
                place.write(line, to);
                continue;
            };
            if directive == "end" {
                return;
            }
            if directive == "include coefficients" {
                let file = match self.plan.formation() {
                    Formation::Attenuating => include_str!("shaders/product.wgsl"),
                    Formation::Additive => include_str!("shaders/sum.wgsl"),
                    Formation::Polarization => include_str!("shaders/rotation.wgsl"),
                };
                self.expand(&mut file.lines(), place, to);
                continue;
            }
            let block = block_of(lines);
            for place in self.places(directive, place) {
                self.expand(&mut block.iter().copied(), &place, to);
            }
        }
    }

    /// Returns the substitutions for each repetition of a block.
    fn places(&self, directive: &str, place: &Place) -> Vec<Place> {
        let plan = self.plan;
        let own = self.update.map(|update| update.own);
        let place = Place { own, ..place.clone() };
        let factors = |range: std::ops::Range<usize>, with_own: bool| {
            let listed = range.filter(|&k| with_own || Some(k) != own);
            listed.map(|k| Place { k: Some(k), ..place.clone() }).collect()
        };
        let (layers, all) = (plan.layer_count(), plan.factor_count());
        match directive {
            "factors" => factors(0..all, true),
            "others" => factors(0..all, false),
            "layers" => factors(0..layers, false),
            "lights" => factors(layers..all, false),
            "frames" => (0..plan.frames()).map(|m| Place { m: Some(m), ..place.clone() }).collect(),
            "pairs" => self.pairs().map(|(m, j)| Place { m: Some(m), j: Some(j), ..place.clone() }).collect(),
            "row" => (0..plan.frames()).map(|j| Place { j: Some(j), ..place.clone() }).collect(),
            "sums" => self.sums().into_iter().map(|sum| Place { sum: Some(sum), ..place.clone() }).collect(),
            condition => {
                let flag = condition.strip_prefix("if ").unwrap_or_default();
                let holds = flag.strip_prefix('!').map_or_else(|| self.is(flag), |flag| !self.is(flag));
                if holds { vec![place] } else { Vec::new() }
            }
        }
    }
}

/// Returns the lines up to the end of the block that has just begun.
fn block_of<'a>(lines: &mut dyn Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut depth = 1;
    let inside = lines.take_while(|line| {
        match line.trim_start().strip_prefix("//@ ") {
            Some("end") => depth -= 1,
            Some("include coefficients") | None => {}
            Some(_) => depth += 1,
        }
        depth > 0
    });
    inside.collect()
}

/// The texts that replace names in braces.
#[derive(Clone, Default)]
struct Place {
    own: Option<usize>,
    k: Option<usize>,
    m: Option<usize>,
    j: Option<usize>,
    sum: Option<String>,
}

impl Place {
    fn write(&self, line: &str, to: &mut String) {
        if line.trim_start().starts_with("//") {
            return;
        }
        let mut line = line.to_owned();
        let mut put = |name: &str, value: Option<usize>| {
            if let Some(value) = value {
                line = line.replace(name, &value.to_string());
            }
        };
        put("{own}", self.own);
        put("{k}", self.k);
        put("{binding}", self.k.map(|k| FIRST_FACTOR + k));
        put("{m}", self.m);
        put("{j}", self.j);
        if let (Some(m), Some(j)) = (self.m, self.j) {
            line = line.replace("{g}", &format!("g{}_{}", m.min(j), m.max(j)));
        }
        if let Some(sum) = &self.sum {
            line = line.replace("{s}", sum);
        }
        to.push_str(&line);
        to.push('\n');
    }
}
