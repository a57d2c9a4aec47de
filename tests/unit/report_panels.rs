use super::*;

#[test]
fn thinning_keeps_outliers_and_the_order() {
    let mut points: Points = (0..100_000).map(|i| (f64::from(i), 1.0)).collect();
    points[77_777].1 = 9.0;
    points[3].1 = -9.0;
    let kept = thinned(&points);
    assert!(kept.len() <= 2 * COLUMNS && kept.contains(&points[77_777]) && kept.contains(&points[3]));
    assert!(kept.is_sorted_by(|a, b| a.0 < b.0));
    assert_eq!(thinned(&points[..1200]), points[..1200]);
}
