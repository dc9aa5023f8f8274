//! The few inner loops that take the time, written so that they vectorise and give the same bits
//! on every machine.

/// tanh as a rational function (odd polynomial of degree 13 over even one of degree 6, on ±7.9),
/// within 4e-7 of the true value. The library's tanh differs between platforms; this does not.
#[inline(always)]
#[must_use]
pub fn tanh(x: f32) -> f32 {
    const ALPHA: [f32; 7] = [
        4.893_524_6e-3,
        6.372_619_3e-4,
        1.485_722_4e-5,
        5.122_297_1e-8,
        -8.604_672e-11,
        2.000_188e-13,
        -2.760_768_5e-16,
    ];
    const BETA: [f32; 4] = [4.893_525e-3, 2.268_434_6e-3, 1.185_347e-4, 1.198_258_4e-6];
    let x = x.clamp(-7.905_311, 7.905_311);
    let x2 = x * x;
    let mut p = ALPHA[6];
    for a in ALPHA[..6].iter().rev() {
        p = p.mul_add(x2, *a);
    }
    let mut q = BETA[3];
    for b in BETA[..3].iter().rev() {
        q = q.mul_add(x2, *b);
    }
    x * p / q
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tanh_is_tanh() {
        for k in -2000..=2000 {
            let x = k as f32 * 0.006;
            let error = (f64::from(tanh(x)) - f64::from(x).tanh()).abs();
            assert!(error < 4e-7, "tanh({x}) is off by {error}");
        }
    }
}
