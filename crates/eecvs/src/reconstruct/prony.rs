//! Starting points for event times from contiguous DTFT coefficients k = 0..r: Prony's problem with known signs.
//!
//! With z_i = exp(-i 2 pi u_i), the coefficients c_k = sum_i p_i z_i^k are power sums, and c_-k = conj(c_k) because
//! times are real.
//!
//! *Matrix pencil.* The matrix H_ab = c_(a - b), a, b = 0..r, is V diag(p) V^H with V_ai = z_i^a. It is Hermitian
//! and of rank n, and its n dominant eigenvectors U span the columns of V. In the least squares sense, U without
//! its last row times Phi is U without its first row, and the eigenvalues of Phi are the z_i (Hua, Sarkar: IEEE
//! Trans. ASSP 38 (1990); Roy, Kailath: ESPRIT, IEEE Trans. ASSP 37 (1989)). For few events the times of the ON
//! events are found by trying all assignments for the smallest residual; for more, they are those with the largest
//! amplitudes.
//!
//! *Newton's identities.* exp(-sum_(k>=1) c_k x^k / k) = prod_on (1 - z x) / prod_off (1 - z x). For events of one
//! polarity this is a polynomial whose roots give their times; it needs only k = 1..=n and no subspace. For both
//! polarities it is the Pade approximant of orders `on` and `off`.

use nalgebra::{Complex, DMatrix, DVector};

use super::equations::Equations;
use super::refine::Work;

type C64 = Complex<f64>;

/// Largest number of events: an eigenvalue problem of this size takes some tens of microseconds.
pub const EVENTS_MAX: usize = 24;
/// Largest number of coefficients used by the pencil, lowest k first.
pub(super) const ROWS_MAX: usize = 32;
/// Largest number of events for which all assignments of signs are tried.
pub(super) const ASSIGNED_MAX: usize = 9;
/// Largest number of iterations in an eigenvalue problem.
const ITERATIONS: usize = 1000;

/// Returns c_0 to c_(r-1).
fn coefficients(equations: &Equations) -> Vec<C64> {
    let zeroth = C64::from(f64::from(equations.on) - f64::from(equations.off));
    let (pairs, _) = equations.middles.as_chunks::<2>();
    let rest = pairs.iter().map(|[re, im]| C64::new(*re, *im));
    std::iter::once(zeroth).chain(rest).collect()
}

/// Returns u of the point nearest to z on the unit circle.
fn time_of(z: C64) -> f64 {
    (-z.arg() / std::f64::consts::TAU).rem_euclid(1.0)
}

/// Returns the times u by the matrix pencil, those of the ON events first.
///
/// Returns `None` for the DCT, if coefficients are missing between the ones sent, for 0 or more than [`EVENTS_MAX`]
/// events, if there are no more coefficients than events, or if the eigenvalues are not found.
#[must_use]
pub fn pencil(equations: &Equations, work: &mut Work) -> Option<Vec<f64>> {
    let n = equations.events();
    if !equations.transform.is_complex() || !equations.are_contiguous() || n > EVENTS_MAX {
        return None;
    }
    let c = coefficients(equations);
    let size = c.len().min(ROWS_MAX);
    if n == 0 || n >= size {
        return None;
    }
    work.spend(equations.size().pencil());
    let matrix = DMatrix::from_fn(
        size,
        size,
        |a, b| {
            if a >= b { c[a - b] } else { c[b - a].conj() }
        },
    );
    let eigen = matrix.try_symmetric_eigen(f64::EPSILON, ITERATIONS)?;
    let mut order: Vec<usize> = (0..size).collect();
    order.sort_by(|a, b| {
        eigen.eigenvalues[*b]
            .abs()
            .total_cmp(&eigen.eigenvalues[*a].abs())
    });
    let u = DMatrix::from_fn(size, n, |row, i| eigen.eigenvectors[(row, order[i])]);
    let (upper, lower) = (u.rows(0, size - 1), u.rows(1, size - 1));
    // V_(a+1) = V_a diag(z): upper Phi = lower.
    let gram = upper.adjoint() * upper;
    let phi = gram.lu().solve(&(upper.adjoint() * lower))?;
    let z = eigenvalues(phi)?;
    sorted_by_sign(equations, &c, &z)
}

/// Returns the eigenvalues of a complex matrix; `None` unless all are finite.
fn eigenvalues(matrix: DMatrix<C64>) -> Option<Vec<C64>> {
    if !matrix.iter().all(|z| z.re.is_finite() && z.im.is_finite()) {
        return None;
    }
    let schur = nalgebra::linalg::Schur::try_new(matrix, f64::EPSILON, ITERATIONS)?;
    let (_, triangle) = schur.unpack();
    let values: Vec<C64> = triangle.diagonal().iter().copied().collect();
    values
        .iter()
        .all(|z| z.re.is_finite() && z.im.is_finite())
        .then_some(values)
}

/// Sorts the times of the ON events first. With few events, they are those of the assignment with the smallest
/// residual, otherwise those with the largest amplitudes.
fn sorted_by_sign(equations: &Equations, c: &[C64], z: &[C64]) -> Option<Vec<f64>> {
    let times: Vec<f64> = z.iter().map(|z| time_of(*z)).collect();
    let n = times.len();
    let on = equations.on as usize;
    if on == 0 || on == n {
        return Some(times);
    }
    let rows = 2 * c.len();
    let part = |z: C64, row: usize| if row.is_multiple_of(2) { z.re } else { z.im };
    let atoms = DMatrix::from_fn(rows, n, |row, i| {
        part(
            C64::cis(-std::f64::consts::TAU * (row / 2) as f64 * times[i]),
            row,
        )
    });
    let target = DVector::from_fn(rows, |row, _| part(c[row / 2], row));
    // |c - A p|^2 = p A^T A p - 2 p A^T c, up to a term independent of p.
    let gram = atoms.transpose() * &atoms;
    let product = atoms.transpose() * &target;
    let order_of = |is_on: &dyn Fn(usize) -> bool| -> Vec<f64> {
        let of = |wanted: bool| (0..n).filter(move |i| is_on(*i) == wanted);
        of(true).chain(of(false)).map(|i| times[i]).collect()
    };
    if n <= ASSIGNED_MAX {
        let cost = |mask: u32| -> f64 {
            let sign = |i: usize| if mask >> i & 1 == 1 { 1.0 } else { -1.0 };
            (0..n)
                .map(|i| {
                    let row: f64 = (0..n).map(|j| gram[(i, j)] * sign(j)).sum();
                    sign(i) * (row - 2.0 * product[i])
                })
                .sum()
        };
        let masks = (0..1_u32 << n).filter(|mask| mask.count_ones() as usize == on);
        let mask = masks.min_by(|a, b| cost(*a).total_cmp(&cost(*b)))?;
        return Some(order_of(&|i| mask >> i & 1 == 1));
    }
    let mut damped = gram.clone();
    for i in 0..n {
        damped[(i, i)] += 1e-9 * rows as f64;
    }
    let amplitudes = damped.cholesky()?.solve(&product);
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| amplitudes[*b].total_cmp(&amplitudes[*a]));
    Some(order.into_iter().map(|i| times[i]).collect())
}

/// Returns the times u by Newton's identities, those of the ON events first; `None` as for [`pencil`], or if a
/// linear system or an eigenvalue problem has no solution.
#[must_use]
pub fn newton(equations: &Equations, work: &mut Work) -> Option<Vec<f64>> {
    let (n, on, off) = (
        equations.events(),
        equations.on as usize,
        equations.off as usize,
    );
    if !equations.transform.is_complex() || !equations.are_contiguous() || n == 0 || n > EVENTS_MAX
    {
        return None;
    }
    let c = coefficients(equations);
    if n >= c.len() {
        return None;
    }
    work.spend(equations.size().newton());
    // With f = exp(-sum c_k x^k / k): k f_k = -sum_(j=1..=k) c_j f_(k-j).
    let mut f = vec![C64::from(1.0)];
    for k in 1..=n {
        let sum: C64 = (1..=k).map(|j| c[j] * f[k - j]).sum();
        f.push(-sum / k as f64);
    }
    // f q = p, with p of degree `on`, q of degree `off` and q_0 = 1: rows on + 1..=n have p = 0.
    let at = |i: isize| if i < 0 { C64::from(0.0) } else { f[i as usize] };
    let mut q = vec![C64::from(1.0)];
    if off > 0 {
        let matrix = DMatrix::from_fn(off, off, |row, column| {
            at((on + row) as isize - column as isize)
        });
        let target = DVector::from_fn(off, |row, _| -f[on + 1 + row]);
        q.extend(matrix.lu().solve(&target)?.iter());
    }
    let p: Vec<C64> = (0..=on)
        .map(|k| (0..=k.min(off)).map(|j| q[j] * f[k - j]).sum())
        .collect();
    let mut times = roots(&p)?;
    times.extend(roots(&q)?);
    Some(times)
}

/// Returns u of the z with prod (1 - z x) = sum p_k x^k, p_0 = 1: the eigenvalues of the companion matrix.
fn roots(p: &[C64]) -> Option<Vec<f64>> {
    let n = p.len() - 1;
    if n == 0 {
        return Some(Vec::new());
    }
    // prod (x - z) = x^n + p_1 x^(n-1) + ...
    let companion = DMatrix::from_fn(n, n, |row, column| {
        if row == 0 {
            -p[column + 1]
        } else if row == column + 1 {
            C64::from(1.0)
        } else {
            C64::from(0.0)
        }
    });
    Some(eigenvalues(companion)?.into_iter().map(time_of).collect())
}
