use proptest::prelude::*;

use super::*;

/// Any finite number, and those at which arithmetic goes wrong.
fn finite() -> impl Strategy<Value = f64> {
    let odd = [0.0, -0.0, 5e-324, 1e-308, f64::MAX, f64::MIN, 1e16, 1.0, 0.1 + 0.2, -1e308];
    let next = any::<f64>().prop_map(f64::next_up).prop_filter("finite", |x| x.is_finite());
    prop_oneof![
        any::<f64>().prop_filter("finite", |x| x.is_finite()),
        next,
        -1e6..1e6,
        proptest::sample::select(odd.to_vec())
    ]
}

/// Two ends in any order, some of them neighbours.
fn range() -> impl Strategy<Value = (f64, f64)> {
    let neighbours = (finite(), 0_u32..9)
        .prop_map(|(low, steps)| (low, (0..steps).fold(low, |high, _| high.next_up()).min(f64::MAX)));
    prop_oneof![(finite(), finite()).prop_map(|(a, b)| (a.min(b), a.max(b))), neighbours]
}

proptest! {
    #[test]
    fn the_ticks_of_any_finite_range_ascend_inside_it(range in range(), most in 1.0..20.0) {
        let ticks = ticks(range, most);
        prop_assert!(ticks.len() as f64 <= most + 2.0, "{:?}", ticks);
        prop_assert!(ticks.is_sorted_by(|a, b| a < b), "{:?}", ticks);
        let is_inside = |tick: &f64| tick.is_finite() && (range.0..=range.1).contains(tick);
        prop_assert!(ticks.iter().all(is_inside), "{:?}", ticks);
    }

    #[test]
    fn a_plot_of_any_numbers_has_different_numbers_along_its_axes(
        x in range(), y in range(), points in proptest::collection::vec((any::<f64>(), any::<f64>()), 0..5)
    ) {
        for (low, high) in [x, y] {
            let (drawn_low, drawn_high) = drawable((low, high));
            prop_assert!(drawn_low < drawn_high && (drawn_low..=drawn_high).contains(&low.clamp(-1e308, 1e308)));
            let numbers = numbers(&ticks((drawn_low, drawn_high), 10.0));
            prop_assert!(!numbers.is_empty() && numbers.windows(2).all(|pair| pair[0] != pair[1]), "{:?}", numbers);
        }
        let mut plot = Plot::new(Layout::FILE, "any", ["x", "y"], x, y);
        plot.line(0, &points);
        plot.steps(1, &points);
        plot.band(2, &points.iter().map(|&(x, y)| (x, y, y)).collect::<Vec<_>>());
        if let Some(&(x, y)) = points.first() {
            plot.interval(3, 0.5, x, Some((x, y)), "interval");
            plot.level(y, "level");
        }
        let svg = plot.finish();
        prop_assert!(!svg.contains("NaN") && !svg.contains("inf\"") && !svg.contains("inf,"), "{}", svg);
    }
}

fn axis(end: f64, most: f64) -> Vec<String> {
    numbers(&ticks((0.0, end), most))
}

#[test]
fn large_numbers_at_an_axis_are_short_and_never_too_many() {
    assert_eq!(axis(1_000_000.0, 5.0), ["0", "200k", "400k", "600k", "800k", "1M"]);
    assert_eq!(axis(12_000_000.0, 5.0), ["0", "5M", "10M"]);
    assert_eq!(
        axis(50_000.0, 10.0),
        ["0", "5k", "10k", "15k", "20k", "25k", "30k", "35k", "40k", "45k", "50k"]
    );
    assert_eq!(axis(7000.0, 10.0), ["0", "1000", "2000", "3000", "4000", "5000", "6000", "7000"]);
    assert_eq!(axis(1.02, 5.0), ["0", "0.5", "1"]);
    assert_eq!(numbers(&ticks((-2.0, 2.0), 5.0)), ["-2", "-1", "0", "1", "2"]);
    // No label may stand out of the narrow plot, whose margin takes six characters.
    assert_eq!(numbers(&ticks((-1e-3, 0.0), 3.0)), ["-1e-3", "-5e-4", "0"]);
    let mut end = 1e-7;
    while end < 1e19 {
        let numbers = axis(end, 5.0);
        assert!((2..=6).contains(&numbers.len()), "{end}: {numbers:?}");
        assert!(numbers.iter().all(|number| number.len() <= 6), "{end}: {numbers:?}");
        end *= 1.37;
    }
}

#[test]
fn one_point_is_seen() {
    let mut plot = Plot::new(Layout::WIDE, "one", ["x", "y"], (0.0, 10.0), (0.0, 1.0));
    plot.line(0, &[(5.0, 0.5)]);
    assert_eq!(plot.finish().matches("<circle").count(), 1);
}

#[test]
fn a_legend_of_any_length_stays_in_the_plot() {
    let mut plot = Plot::new(Layout::FILE, &"t".repeat(200), ["x", "y"], (0.0, 10.0), (0.0, 1.0));
    plot.legend(0, &"n".repeat(200));
    let svg = plot.finish();
    let texts = svg.split('>').filter_map(|piece| piece.strip_suffix("</text"));
    assert!(texts.map(|text| text.chars().count()).all(|length| length <= LINE), "{svg}");
    assert!(svg.contains(r#"height="490""#), "three more lines below, and two above: {svg}");
}
