use super::*;

#[test]
fn powers_by_squaring_equal_powers_by_multiplying() {
    for exponent in [0, 1, 2, 3, 10, 1000] {
        let product = (0..exponent).fold(1.0, |product, _| product * 0.999);
        assert!((power(0.999, exponent) - product).abs() < 1e-13, "exponent {exponent}");
    }
}
