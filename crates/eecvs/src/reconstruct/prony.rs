//! First event times from contiguous coefficients k = 0..r of the DTFT: Prony's problem with known
//! signs.
//!
//! With z_i = exp(-i 2 pi u_i), c_k = sum_i p_i z_i^k are power sums, and c_-k = conj(c_k) as times
//! are real.
//!
//! *Matrix pencil.* H_ab = c_(a - b), a, b = 0..r, is V diag(p) V^H with V_ai = z_i^a: a Hermitian
//! matrix of rank n, whose n dominant eigenvectors U span V's columns. U without its last row times
//! Phi is U without its first row, in the least squares; the eigenvalues of Phi are the z_i
//! (Hua, Sarkar: IEEE Trans. ASSP 38 (1990); Roy, Kailath: ESPRIT, IEEE Trans. ASSP 37 (1989)).
//! Which of them are ON is the assignment with the least residual; of many, the largest amplitudes.
//!
//! *Newton's identities.* exp(-sum_(k>=1) c_k x^k / k) = prod_on (1 - z x) / prod_off (1 - z x):
//! for events of one polarity a polynomial whose roots are their times, which needs k = 1..=n alone
//! and no subspace; for both polarities its Pade approximant of orders `on` and `off`.

use nalgebra::{Complex, DMatrix, DVector};

use super::equations::Equations;

type C64 = Complex<f64>;

/// Most events: an eigenvalue problem of this size is a matter of some tens of microseconds.
pub const EVENTS_MAX: usize = 24;
/// Most coefficients that the pencil takes, the lowest of more.
const ROWS_MAX: usize = 32;
/// Most events whose assignments to signs are all tried.
const ASSIGNED_MAX: usize = 9;
/// Iterations of an eigenvalue problem.
const ITERATIONS: usize = 1000;

/// c_0 to c_(r-1).
fn coefficients(equations: &Equations) -> Vec<C64> {
    let zeroth = C64::from(f64::from(equations.on) - f64::from(equations.off));
    let (pairs, _) = equations.middles.as_chunks::<2>();
    let rest = pairs.iter().map(|[re, im]| C64::new(*re, *im));
    std::iter::once(zeroth).chain(rest).collect()
}

/// u of z, the nearest point on the circle.
fn time_of(z: C64) -> f64 {
    (-z.arg() / std::f64::consts::TAU).rem_euclid(1.0)
}

/// Times in the order of the signs by the matrix pencil, where there are more coefficients than
/// events and the eigenvalues are found.
#[must_use]
pub fn pencil(equations: &Equations) -> Option<Vec<f64>> {
    let n = equations.events();
    if !equations.transform.is_complex() || !equations.are_contiguous() || n > EVENTS_MAX {
        return None;
    }
    let c = coefficients(equations);
    let size = c.len().min(ROWS_MAX);
    if n == 0 || n >= size {
        return None;
    }
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

/// Eigenvalues of a complex matrix, all finite.
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

/// Which times are ON: of few events by the least residual of all assignments, else those with the
/// largest amplitudes.
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
    // |c - A p|^2 = p A^T A p - 2 p A^T c, but for what does not depend on p.
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

/// Times in the order of the signs by Newton's identities.
#[must_use]
pub fn newton(equations: &Equations) -> Option<Vec<f64>> {
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
    // f = exp(-sum c_k x^k / k): k f_k = -sum_(j=1..=k) c_j f_(k-j).
    let mut f = vec![C64::from(1.0)];
    for k in 1..=n {
        let sum: C64 = (1..=k).map(|j| c[j] * f[k - j]).sum();
        f.push(-sum / k as f64);
    }
    // f q = p with p of degree `on`, q of degree `off`, q_0 = 1: rows on + 1..=n have p = 0.
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

/// u of the z with prod (1 - z x) = sum p_k x^k, p_0 = 1: eigenvalues of the companion matrix.
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
