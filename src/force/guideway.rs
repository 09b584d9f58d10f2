//! How far a guideway moves until its friction has turned: stated by the model, or what motion has said of
//! it; how it is learned stands in `guideway_learner`.

/// One number of each travel.
pub(super) type Each = [f64; 8];

/// Travels that rolling and sliding guideways and ball screws have, m: preferred numbers (ISO 3, R5) about
/// the "few micrometres" of Armstrong-Helouvry et al. (Automatica 30, 1994).
pub(super) const TRAVELS_M: Each = [1e-6, 1.6e-6, 2.5e-6, 4e-6, 6.3e-6, 10e-6, 16e-6, 25e-6];

/// How far a guideway moves until its friction has turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GuidewayTravel {
    /// The model states it, m.
    Stated(f64),
    /// It does not: what motion has said of it.
    Learned(Evidence),
}

/// Log-likelihood of each travel, up to one constant; all alike: nothing is known.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Evidence {
    pub(super) log_likelihood: Each,
}

crate::keyframe::keep!(Evidence { log_likelihood });

impl Default for GuidewayTravel {
    fn default() -> Self {
        Self::Learned(Evidence::default())
    }
}

impl GuidewayTravel {
    /// One number for those who need one: as stated, or the middle of what is likely, m.
    #[must_use]
    pub fn travel_m(&self) -> f64 {
        match self {
            Self::Stated(travel_m) => *travel_m,
            Self::Learned(evidence) => evidence.moments()[0].exp(),
        }
    }

    /// Friction of a balance that turns over a travel that is stated; what is learned is taken off beyond the
    /// balance. Friction that is given back is no guideway's and stays in it.
    pub(super) fn in_balance_n(&self, friction_n: f64) -> f64 {
        match self {
            Self::Stated(_) => friction_n,
            Self::Learned(_) => friction_n.min(0.0),
        }
    }

    /// The travel, where it is stated or was learned, m.
    #[must_use]
    pub fn known_m(&self) -> Option<f64> {
        let known = !matches!(self, Self::Learned(evidence) if !evidence.is_known());
        known.then(|| self.travel_m())
    }

    /// Least and most that it can be, m.
    pub(super) fn bounds_m(&self) -> [f64; 2] {
        let [least_m, .., most_m] = TRAVELS_M;
        self.known_m().map_or([least_m, most_m], |travel_m| [travel_m; 2])
    }

    /// Where it comes from, for files.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Stated(_) => "stated by the model".to_owned(),
            Self::Learned(evidence) if evidence.is_known() => "learned from motion".to_owned(),
            Self::Learned(_) => {
                let [least_m, most_m] = self.bounds_m();
                format!("not known, {least_m:.0e} to {most_m:.1e} m: neither stated nor learned")
            }
        }
    }
}

impl Evidence {
    /// Share of each travel. Laws of neighbours are mixed where the likelihood has its summit between them.
    pub(super) fn weights(&self) -> Each {
        let most = self.log_likelihood.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let likely = self.log_likelihood.map(|l| (l - most).exp());
        let sum: f64 = likely.iter().sum();
        let (toward, part) = self.summit();
        let mut weights = [0.0; 8];
        for (k, w) in likely.into_iter().enumerate() {
            let next = if toward { k + 1 } else { k.wrapping_sub(1) };
            let part = if next < weights.len() { part } else { 0.0 };
            weights[k] += (1.0 - part) * w / sum;
            if let Some(weight) = weights.get_mut(next) {
                *weight += part * w / sum;
            }
        }
        weights
    }

    /// Where between two travels of the series the summit lies: toward the longer one, and how much of a step
    /// beyond the likeliest; the vertex of the parabola through it and its neighbours.
    fn summit(&self) -> (bool, f64) {
        let of = |three: &[f64]| match *three {
            [below, here, above] if here >= below && here >= above && here > below.min(above) => {
                Some(0.5 * (below - above) / (below - 2.0 * here + above))
            }
            _ => None,
        };
        let most = |three: &&[f64]| self.log_likelihood.iter().all(|l| *l <= three[1]);
        let beyond = self.log_likelihood.windows(3).find(most).and_then(of).unwrap_or(0.0);
        (beyond > 0.0, beyond.abs())
    }

    /// Mean and standard deviation of ln(d).
    fn moments(&self) -> [f64; 2] {
        let (weights, logs) = (self.weights(), TRAVELS_M.map(f64::ln));
        let over = |f: &dyn Fn(f64) -> f64| weights.iter().zip(logs).map(|(w, log)| w * f(log)).sum::<f64>();
        let mean = over(&|log| log);
        [mean, over(&|log| (log - mean).powi(2)).sqrt()]
    }

    /// Whether the travel is known to within a step of the series.
    #[must_use]
    pub fn is_known(&self) -> bool {
        let [first, second, ..] = TRAVELS_M;
        self.moments()[1] < (second / first).ln()
    }
}
