//! Stretches in which the two gyroscopes do not move as one body, or a clock has stepped.
//!
//! People press record first and take a firm hold a moment later, let go before the end,
//! or knock a mount out of its place. The rest is as good as any twist. So the relation
//! of clocks and sensors is fitted to the largest part of the overlap that one
//! relation explains: to a short window at first, then to all blocks of time that
//! this explains, with a tolerance that becomes narrower round by round. Of all windows,
//! the one that leads to the largest part counts.
//!
//! Stretches that are left out are classified by their cause: another relation of the clocks
//! at the same rotation between the sensors ([`Why::TimeStep`]), or anything else, such as a
//! slip ([`Why::Apart`]).
//!
//! Limits: a turn by less than about a degree cannot be distinguished from an error of the sensors.

use nalgebra::{Matrix3, Vector3};

use super::calibration::{self, Calibration};
use super::fit::{self, Fit, FitOptions, Link, Node};
use crate::faults::Why;
use crate::signal::Signal;
use crate::signal::interpolant::Vec3;

/// Length of the blocks of time that are judged, seconds; longer if there would be more
/// than [`MOST_BLOCKS`].
const BLOCK_S: f64 = 0.25;
const MOST_BLOCKS: f64 = 240.0;
/// Windows from which the search starts, at most.
const MOST_WINDOWS: usize = 20;
/// Blocks of a window from which the search starts: 1.5 s.
const WINDOW: usize = 6;
/// Part of the motion's rms that may stay unexplained in a block: this multiple of the usual
/// part, within these bounds.
const TIMES_USUAL: f64 = 5.0;
const LEAST_TOLERANCE: f64 = 0.006;
const MOST_TOLERANCE: f64 = 0.03;
/// The tolerance is wider at first, by these factors.
const WIDER: [f64; 2] = [4.0, 2.0];
/// In-band noise that is allowed on top, in multiples of its rms.
const NOISE: f64 = 3.0;
/// Part of the motion below which a residual is not examined.
const EXPLAINED: f64 = 0.004;
/// Factor by which the usual unexplained part of a window's relation may exceed the best one.
const MUCH_BETTER: f64 = 2.5;
/// A block counts as moving above this part of the largest block's rms.
const MOVING: f64 = 0.15;
/// Left out on either side of a stretch, seconds.
const MARGIN_S: f64 = 0.1;
/// Stretches closer than this are one, seconds.
pub(crate) const JOIN_S: f64 = 0.3;
/// Shortest stretch whose cause is looked for, seconds.
const SHORTEST_S: f64 = 0.7;
/// Largest part of the motion's rms that a cause may leave unexplained.
const CAUSE: f64 = 0.05;
/// Steps of time that are tried, seconds.
const STEP_REACH_S: f64 = 0.5;
const STEP_GRID_S: f64 = 5e-3;

/// A stretch of the data's time that is left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stretch {
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// Cause; the time of a [`Why::TimeStep`] is the data's time, later than in the rest.
    pub(crate) why: Why,
    /// Its part of the motion's power.
    power: f64,
    /// Its part of the time in motion.
    time: f64,
}

/// Share of the motion that is kept without these stretches: of its power, or of its time
/// where that is less.
pub(crate) fn kept_share<'a>(left_out: impl Iterator<Item = &'a Stretch> + Clone) -> f64 {
    let power: f64 = left_out.clone().map(|s| s.power).sum();
    let time: f64 = left_out.map(|s| s.time).sum();
    1.0 - power.max(time)
}

/// The largest part of the overlap that one relation explains.
pub(crate) struct Part {
    pub(crate) fit: Fit,
    /// Stretches that are left out, in order of time.
    pub(crate) stretches: Vec<Stretch>,
    /// Residual power over the motion's, in what is kept.
    pub(crate) unexplained: f64,
    kept: Vec<bool>,
    blocks: Blocks,
}

impl Part {
    /// Returns the nodes in the kept blocks.
    pub(crate) fn kept(&self, data: &[(f64, Vec3)]) -> Vec<(f64, Vec3)> {
        self.blocks.kept(data, &self.kept)
    }

    /// Strength of the evidence: `n · ln(unexplained)` of what is kept.
    pub(crate) fn evidence(&self) -> f64 {
        self.fit.nodes.len() as f64 * self.unexplained.ln()
    }
}

/// Equal blocks of the data's time.
#[derive(Debug, Clone, Copy)]
struct Blocks {
    from: f64,
    /// Length of each, seconds.
    length: f64,
    count: usize,
}

impl Blocks {
    fn index_at(self, t: f64) -> Option<usize> {
        let at = (t - self.from) / self.length;
        (at >= 0.0 && at < self.count as f64).then_some(at as usize)
    }

    fn begin(self, block: usize) -> f64 {
        self.from + self.length * block as f64
    }

    fn kept(self, data: &[(f64, Vec3)], kept: &[bool]) -> Vec<(f64, Vec3)> {
        let is_kept = |t| self.index_at(t).is_some_and(|block| kept[block]);
        data.iter().filter(|(t, _)| is_kept(*t)).copied().collect()
    }

    /// Returns the rms per axis of the vectors in each block, and 0 for an empty one. It is
    /// derived from the 80 % quantile of the squares, so that a spike does not count, and a
    /// turn of 50 ms does.
    fn rms(self, values: impl Iterator<Item = (f64, Vector3<f64>)>) -> Vec<f64> {
        let mut squares: Vec<Vec<f64>> = vec![Vec::new(); self.count];
        for (t, value) in values {
            if let Some(block) = self.index_at(t) {
                squares[block].push(value.norm_squared());
            }
        }
        let typical = |squares: &mut Vec<f64>| {
            let at = squares.len() * 4 / 5;
            let square = match squares.len() {
                0 => 0.0,
                _ => *squares.select_nth_unstable_by(at, f64::total_cmp).1,
            };
            // For three normal axes of variance 1 that quantile is 4.64.
            (square / 4.64).sqrt()
        };
        squares.iter_mut().map(typical).collect()
    }
}

/// Input of the search.
struct Search<'a> {
    model: &'a Signal,
    data: &'a [(f64, Vec3)],
    /// Other lags at which the two streams may belong together, seconds.
    rivals: &'a [f64],
    options: FitOptions,
    blocks: Blocks,
    /// Rms of the motion around each block.
    motion: Vec<f64>,
    moving: Vec<bool>,
}

/// Result of growing a window.
struct Consensus {
    fit: Fit,
    kept: Vec<bool>,
    /// Usual part of the motion that is unexplained in a kept block.
    usual: f64,
    /// Power of motion in the kept blocks.
    power: f64,
}

/// Returns true if a quick fit explains the whole overlap, so that no search for a part is
/// needed.
pub(crate) fn is_whole(fit: &Fit, noise_variance: f64) -> bool {
    let motion = fit.motion_variance();
    let residual = fit.residual_variance();
    let residuals = fit.nodes.iter().map(|n| (n.t, n.residual));
    let blocks = blocks_of(&fit.nodes).map(|blocks| blocks.rms(residuals));
    let loudest = blocks.into_iter().flatten().fold(0.0, f64::max);
    let limit = (EXPLAINED * EXPLAINED * motion).max(4.0 * noise_variance);
    residual <= limit && loudest * loudest <= 9.0 * limit
}

fn blocks_of(nodes: &[Node]) -> Option<Blocks> {
    let (first, last) = (nodes.first()?.t, nodes.last()?.t);
    let length = ((last - first) / MOST_BLOCKS).max(BLOCK_S);
    Some(Blocks {
        from: first,
        length,
        count: ((last - first) / length) as usize + 1,
    })
}

/// Returns the largest part of the overlap that one relation near that of `whole` explains;
/// `data` are nodes of the data, `rivals` other possible lags (s, data minus model). `None` if
/// no window leads to one.
pub(crate) fn part(
    model: &Signal,
    data: &[(f64, Vec3)],
    whole: &Fit,
    rivals: &[f64],
    options: FitOptions,
) -> Option<Part> {
    let blocks = blocks_of(&whole.nodes)?;
    let mean = fit::mean(whole.nodes.iter().map(|n| n.y));
    let own = blocks.rms(whole.nodes.iter().map(|n| (n.t, n.y - mean)));
    let around = |k: usize| {
        let near = &own[k.saturating_sub(1)..(k + 2).min(own.len())];
        near.iter().copied().fold(0.0, f64::max)
    };
    let motion: Vec<f64> = (0..own.len()).map(around).collect();
    let largest = motion.iter().copied().fold(0.0, f64::max);
    let search = Search {
        model,
        data,
        rivals,
        options,
        blocks,
        moving: own.iter().map(|&m| m > MOVING * largest).collect(),
        motion,
    };
    let found = search.best(whole.link)?;
    Some(search.finished(found))
}

impl Search<'_> {
    fn best(&self, start: Link) -> Option<Consensus> {
        let count = self.blocks.count;
        let is_moving = |from: &usize| {
            let moving = self.moving[*from..from + WINDOW].iter().filter(|m| **m);
            2 * moving.count() > WINDOW
        };
        let windows = (0..count.saturating_sub(WINDOW - 1)).step_by(WINDOW / 2);
        let windows: Vec<usize> = windows.filter(is_moving).collect();
        let every = windows.len().div_ceil(MOST_WINDOWS).max(1);
        let starts = windows.into_iter().step_by(every).map(|from| {
            let mut kept = vec![false; count];
            kept[from..from + WINDOW].fill(true);
            kept
        });
        let mut found: Vec<Consensus> = starts
            .filter_map(|window| self.consensus(start, window))
            .collect();
        let least = found.iter().map(|c| c.usual).fold(f64::INFINITY, f64::min);
        let best = least.max(LEAST_TOLERANCE / TIMES_USUAL);
        found.extend(self.consensus(start, vec![true; count]));
        found
            .into_iter()
            .filter(|c| c.usual <= MUCH_BETTER * best)
            .max_by(|x, y| x.power.total_cmp(&y.power))
    }

    /// Grows the kept blocks to all that one relation explains.
    fn consensus(&self, start: Link, mut kept: Vec<bool>) -> Option<Consensus> {
        let mut fit = self.fitted(start, &kept)?;
        let mut usual = self.usual(&fit, &kept);
        // A window that no relation explains is no place to start from.
        if usual > WIDER[0] * MOST_TOLERANCE {
            return None;
        }
        let tolerance = |usual: f64| (TIMES_USUAL * usual).clamp(LEAST_TOLERANCE, MOST_TOLERANCE);
        for wider in WIDER {
            kept = self.explained(&fit, wider * tolerance(usual))?;
            fit = self.fitted(fit.link, &kept)?;
        }
        for _ in 0..3 {
            usual = self.usual(&fit, &kept);
            let next = self.explained(&fit, tolerance(usual))?;
            if next == kept {
                break;
            }
            kept = next;
            fit = self.fitted(fit.link, &kept)?;
        }
        let power = self.power(|block| kept[block]);
        Some(Consensus {
            fit,
            kept,
            usual,
            power,
        })
    }

    fn fitted(&self, start: Link, kept: &[bool]) -> Option<Fit> {
        let data = self.blocks.kept(self.data, kept);
        let even = Some(Matrix3::identity());
        fit::fit(self.model, &data, start, even, &self.options)
    }

    /// Returns the power of the motion in the chosen blocks.
    fn power(&self, chosen: impl Fn(usize) -> bool) -> f64 {
        let chosen = (0..self.blocks.count).filter(|&block| chosen(block));
        chosen.map(|block| self.motion[block].powi(2)).sum()
    }

    fn errors(&self, fit: &Fit) -> Vec<f64> {
        let nodes = fit::nodes(self.model, self.data, &fit.link, &fit.calibration);
        let nodes = nodes.unwrap_or_default();
        self.blocks.rms(nodes.iter().map(|n| (n.t, n.residual)))
    }

    /// Returns the blocks that a relation explains; `None` if hardly any of them moves.
    fn explained(&self, fit: &Fit, tolerance: f64) -> Option<Vec<bool>> {
        let noise = NOISE * self.options.noise_variance.sqrt();
        let kept: Vec<bool> = self
            .errors(fit)
            .iter()
            .zip(&self.motion)
            .map(|(error, motion)| *error <= tolerance * motion + noise)
            .collect();
        let moving = kept.iter().zip(&self.moving).filter(|(k, m)| **k && **m);
        (2 * moving.count() > WINDOW).then_some(kept)
    }

    /// Returns the median unexplained part over the kept blocks that move.
    fn usual(&self, fit: &Fit, kept: &[bool]) -> f64 {
        let errors = self.errors(fit);
        let chosen = (0..kept.len()).filter(|&k| kept[k] && self.moving[k]);
        let mut parts: Vec<f64> = chosen.map(|k| errors[k] / self.motion[k]).collect();
        crate::robust::median_in_place(&mut parts).unwrap_or(f64::INFINITY)
    }

    fn finished(&self, found: Consensus) -> Part {
        let all = self.power(|_| true).max(f64::MIN_POSITIVE);
        let moving = self.moving.iter().filter(|m| **m).count().max(1) as f64;
        let noise = NOISE * self.options.noise_variance.sqrt();
        let mut stretches: Vec<Stretch> = Vec::new();
        let errors = self.errors(&found.fit);
        for (block, _) in found.kept.iter().enumerate().filter(|(_, kept)| !**kept) {
            let begin = self.blocks.begin(block);
            let (mut from, mut to) = (begin - MARGIN_S, begin + self.blocks.length + MARGIN_S);
            if block == 0 {
                from = f64::NEG_INFINITY;
            }
            if block + 1 == self.blocks.count {
                to = f64::INFINITY;
            }
            let own = self.power(|other| other == block) / all;
            let lasts = f64::from(u8::from(self.moving[block])) / moving;
            match stretches.last_mut() {
                Some(last) if from - last.to < JOIN_S => {
                    last.to = to;
                    last.power += own;
                    last.time += lasts;
                }
                _ => stretches.push(Stretch {
                    from,
                    to,
                    why: Why::Apart,
                    power: own,
                    time: lasts,
                }),
            }
        }
        // A knock is a block a little above the limit: its weight is lowered later.
        stretches.retain(|stretch| {
            let block = self
                .blocks
                .index_at(stretch.to - MARGIN_S - 0.5 * self.blocks.length);
            let is_loud = |block: usize| {
                errors[block] > 3.0 * (found.usual * TIMES_USUAL * self.motion[block] + noise)
            };
            stretch.to - stretch.from > 1.5 * self.blocks.length + 2.0 * MARGIN_S
                || block.is_none_or(is_loud)
        });
        for stretch in &mut stretches {
            stretch.why = self.why(stretch, &found.fit);
        }
        let motion = found.fit.motion_variance().max(f64::MIN_POSITIVE);
        Part {
            unexplained: (found.fit.residual_variance() / motion).max(1e-14),
            fit: found.fit,
            stretches,
            kept: found.kept,
            blocks: self.blocks,
        }
    }

    /// Finds the cause of a stretch that the relation does not explain.
    fn why(&self, stretch: &Stretch, fit: &Fit) -> Why {
        let trim = 2.0 * MARGIN_S;
        let within = (stretch.from + trim)..=(stretch.to - trim);
        if stretch.to - stretch.from - 2.0 * trim < SHORTEST_S {
            return Why::Apart;
        }
        let chosen = self.data.iter().filter(|(t, _)| within.contains(t));
        let data: Vec<(f64, Vec3)> = chosen.copied().collect();
        let nodes_at = |later_s: f64| {
            let link = Link {
                at_model: fit.link.at_model - later_s,
                ..fit.link
            };
            fit::nodes(self.model, &data, &link, &fit.calibration)
        };
        let Some(nodes) = nodes_at(0.0) else {
            return Why::Apart;
        };
        let motion = fit::variance(nodes.iter().map(|n| n.y)).sqrt();
        let unexplained = self.residual(&nodes, &fit.calibration);
        let noise = NOISE * self.options.noise_variance.sqrt();
        let limit = (CAUSE * motion + noise).min(0.5 * unexplained);
        let turned = self.residual(&nodes, &self.regressed(&nodes));
        let steps = (STEP_REACH_S / STEP_GRID_S) as i32;
        let lag_s = -fit.link.model_time(0.0);
        let on_grid = (-steps..=steps)
            .map(|k| STEP_GRID_S * f64::from(k))
            .chain(self.rivals.iter().map(|rival| rival - lag_s));
        let nearest = on_grid
            .filter_map(|later_s| {
                Some((
                    self.residual(&nodes_at(later_s)?, &fit.calibration),
                    later_s,
                ))
            })
            .min_by(|x, y| x.0.total_cmp(&y.0))
            .map_or(0.0, |(_, later_s)| later_s);
        let mut later_s = nearest;
        for _ in 0..3 {
            let nodes = nodes_at(later_s).unwrap_or_default();
            let slope: f64 = nodes.iter().map(|n| n.slope.norm_squared()).sum();
            let score: f64 = nodes.iter().map(|n| n.slope.dot(&n.residual)).sum();
            later_s -= score / slope.max(f64::MIN_POSITIVE);
        }
        let stepped = nodes_at(later_s);
        let stepped = stepped.map_or(f64::INFINITY, |n| self.residual(&n, &fit.calibration));
        if stepped < limit && stepped < 1.5 * turned {
            Why::TimeStep(later_s)
        } else {
            Why::Apart
        }
    }

    /// Returns the rms of the residual in each block.
    fn residuals(&self, nodes: &[Node], calibration: &Calibration) -> Vec<f64> {
        let residual = |n: &Node| calibration.residual(&n.x, &n.y);
        self.blocks.rms(nodes.iter().map(|n| (n.t, residual(n))))
    }

    /// Returns the median rms of the blocks: the moments of a slip itself do not count.
    fn residual(&self, nodes: &[Node], calibration: &Calibration) -> f64 {
        usual(self.residuals(nodes, calibration))
    }

    /// Returns the sensors' relation that most of the nodes follow.
    fn regressed(&self, nodes: &[Node]) -> Calibration {
        let regressed = |nodes: &[Node]| {
            calibration::regress(nodes.iter().map(Node::rates), self.options.noise_variance)
        };
        let mut calibration = regressed(nodes);
        for _ in 0..3 {
            let each = self.residuals(nodes, &calibration);
            let limit = 2.0 * usual(each.clone());
            let is_usual = |n: &&Node| self.blocks.index_at(n.t).is_some_and(|b| each[b] <= limit);
            let most: Vec<Node> = nodes.iter().filter(is_usual).copied().collect();
            calibration = regressed(&most);
        }
        calibration
    }
}

/// Median of the residuals that are not zero, as in empty blocks.
fn usual(mut each: Vec<f64>) -> f64 {
    each.retain(|&rms| rms > 0.0);
    crate::robust::median_in_place(&mut each).unwrap_or(f64::INFINITY)
}
