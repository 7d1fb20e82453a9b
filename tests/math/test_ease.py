"""Easings: the published formulas, ends, slopes, and a browser's own CSS easings."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from keypose.errors import ShapeError, UnknownName
from keypose.math import ease

C1 = 1.70158
C2, C3, C4, C5 = C1 * 1.525, C1 + 1, 2 * math.pi / 3, 2 * math.pi / 4.5


def bounce_out(x):
    n1, d1 = 7.5625, 2.75
    if x < 1 / d1:
        return n1 * x * x
    if x < 2 / d1:
        return n1 * (x - 1.5 / d1) ** 2 + 0.75
    if x < 2.5 / d1:
        return n1 * (x - 2.25 / d1) ** 2 + 0.9375
    return n1 * (x - 2.625 / d1) ** 2 + 0.984375


# As https://easings.net publishes them.
PUBLISHED = {
    "sine_in": lambda x: 1 - math.cos(x * math.pi / 2),
    "sine_out": lambda x: math.sin(x * math.pi / 2),
    "sine_in_out": lambda x: -(math.cos(math.pi * x) - 1) / 2,
    "quad_in": lambda x: x * x,
    "quad_out": lambda x: 1 - (1 - x) * (1 - x),
    "quad_in_out": lambda x: 2 * x * x if x < 0.5 else 1 - (-2 * x + 2) ** 2 / 2,
    "cubic_in": lambda x: x**3,
    "cubic_out": lambda x: 1 - (1 - x) ** 3,
    "cubic_in_out": lambda x: 4 * x**3 if x < 0.5 else 1 - (-2 * x + 2) ** 3 / 2,
    "quart_in": lambda x: x**4,
    "quart_out": lambda x: 1 - (1 - x) ** 4,
    "quart_in_out": lambda x: 8 * x**4 if x < 0.5 else 1 - (-2 * x + 2) ** 4 / 2,
    "quint_in": lambda x: x**5,
    "quint_out": lambda x: 1 - (1 - x) ** 5,
    "quint_in_out": lambda x: 16 * x**5 if x < 0.5 else 1 - (-2 * x + 2) ** 5 / 2,
    "expo_in": lambda x: 0 if x == 0 else 2 ** (10 * x - 10),
    "expo_out": lambda x: 1 if x == 1 else 1 - 2 ** (-10 * x),
    "expo_in_out": lambda x: x if x in (0, 1) else 2 ** (20 * x - 10) / 2 if x < 0.5 else (2 - 2 ** (-20 * x + 10)) / 2,
    "circ_in": lambda x: 1 - math.sqrt(1 - x * x),
    "circ_out": lambda x: math.sqrt(1 - (x - 1) ** 2),
    "circ_in_out": lambda x: (
        (1 - math.sqrt(1 - (2 * x) ** 2)) / 2 if x < 0.5 else (math.sqrt(1 - (-2 * x + 2) ** 2) + 1) / 2
    ),
    "back_in": lambda x: C3 * x**3 - C1 * x * x,
    "back_out": lambda x: 1 + C3 * (x - 1) ** 3 + C1 * (x - 1) ** 2,
    "back_in_out": lambda x: (
        (2 * x) ** 2 * ((C2 + 1) * 2 * x - C2) / 2
        if x < 0.5
        else ((2 * x - 2) ** 2 * ((C2 + 1) * (x * 2 - 2) + C2) + 2) / 2
    ),
    "elastic_in": lambda x: x if x in (0, 1) else -(2 ** (10 * x - 10)) * math.sin((x * 10 - 10.75) * C4),
    "elastic_out": lambda x: x if x in (0, 1) else 2 ** (-10 * x) * math.sin((x * 10 - 0.75) * C4) + 1,
    "elastic_in_out": lambda x: (
        x
        if x in (0, 1)
        else -(2 ** (20 * x - 10) * math.sin((20 * x - 11.125) * C5)) / 2
        if x < 0.5
        else 2 ** (-20 * x + 10) * math.sin((20 * x - 11.125) * C5) / 2 + 1
    ),
    "bounce_in": lambda x: 1 - bounce_out(1 - x),
    "bounce_out": bounce_out,
    "bounce_in_out": lambda x: (1 - bounce_out(1 - 2 * x)) / 2 if x < 0.5 else (1 + bounce_out(2 * x - 1)) / 2,
    "linear": lambda x: x,
    "smoothstep": lambda x: 3 * x**2 - 2 * x**3,
    "smootherstep": lambda x: 6 * x**5 - 15 * x**4 + 10 * x**3,
}
CSS = ("ease", "ease_in", "ease_out", "ease_in_out")


def test_the_catalogue_is_penners_and_csss():
    assert set(ease.names()) == {*PUBLISHED, *CSS}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_formulas(name, library):
    u = np.linspace(0, 1, 401)
    # the published exponentials miss one end and jump there by 1/1024
    tolerance = 1.0 / 1023 if name.startswith(("expo", "elastic")) else 40 * library.eps
    if name.startswith("circ") and library.dtype == "float32":
        tolerance = 1e-3  # upright at the end: half the digits
    expected = [PUBLISHED[name](x) for x in u]
    np.testing.assert_allclose(library.numpy(ease.ease(name, library.array(u))), expected, atol=tolerance)


@pytest.mark.parametrize("name", ease.names())
def test_ends_are_exact_and_nothing_jumps(name, library):
    found = library.numpy(ease.ease(name, library.array([-1.0, 0.0, 1.0, 7.0])))
    np.testing.assert_array_equal(found, [0, 0, 1, 1])
    fine = ease.ease(name, np.linspace(0, 1, 100001))
    assert np.abs(np.diff(fine)).max() < 5e-3


@pytest.mark.parametrize("name", ease.names())
def test_slopes_are_differences_on_both_sides(name):
    curve = ease.easing(name)
    h = 1e-7
    corners = [p.start for p in curve.pieces[1:]]
    u = np.array([*np.linspace(0, 1, 42)[1:-1], *corners])
    assert not set(corners) & set(np.linspace(0, 1, 42)[1:-1])
    later, earlier = (curve(u + h) - curve(u)) / h, (curve(u) - curve(u - h)) / h
    for found, expected in ((curve.slope(u), later), (curve.slope(u, from_left=True), earlier)):
        smooth = np.isfinite(found)
        assert name.startswith("circ") or smooth.all()
        np.testing.assert_allclose(found[smooth], expected[smooth], atol=3e-5 * np.abs(found[smooth]).max())


def test_how_movements_start_and_stop():
    level_start = {"sine_in", "quad_in", "circ_in", "back_in", "smoothstep", "smootherstep", "ease_in", "ease_in_out"}
    level_end = {"sine_out", "cubic_out", "quint_out", "circ_out", "back_out", "smoothstep", "ease_out", "ease"}
    for name in level_start:
        assert ease.easing(name).slope(0.0) == pytest.approx(0, abs=1e-12)
    for name in level_end:
        assert ease.easing(name).slope(1.0, from_left=True) == pytest.approx(0, abs=1e-9)
    assert ease.easing("circ_in").slope(1.0, from_left=True) == np.inf
    assert ease.easing("bounce_out").slope(1 / 2.75, from_left=True) == pytest.approx(5.5)
    assert ease.easing("bounce_out").slope(1 / 2.75) == pytest.approx(-2.75)
    for upright, start in (((0, 1, 1, 1), np.inf), ((0, 0, 0.5, 1), 2.0), ((0, 0, 0, 1), np.inf), ((0, 0, 0, 0), 1.0)):
        assert ease.cubic_bezier(*upright).slope(0.0) == start


def test_every_out_is_its_in_backwards():
    u = np.linspace(0, 1, 50)
    for name in ease.names():
        if name.endswith("_in") and name != "ease_in":
            np.testing.assert_allclose(ease.ease(name[:-2] + "out", u), 1 - ease.ease(name, 1 - u), atol=1e-15)
        if name.endswith("_in_out"):
            np.testing.assert_allclose(ease.ease(name, u), 1 - ease.ease(name, 1 - u), atol=1e-12)


def test_names_teach():
    with pytest.raises(UnknownName, match="nearest: 'bounce_out'"):
        ease.easing("bonce_out")
    with pytest.raises(ShapeError, match=r"x2: expected 0\.\.1"):
        ease.easing("cubic-bezier(0, 0, 1.5, 1)")
    with pytest.raises(ShapeError, match="four numbers"):
        ease.easing("cubic-bezier(1, 2)")
    with pytest.raises(ShapeError, match="2 or more steps, got 1"):
        ease.easing("steps(1, jump-none)")
    with pytest.raises(UnknownName, match="nearest: 'jump-end'"):
        ease.easing("steps(3, jump-ende)")
    assert ease.easing("ease-in-out").label == "Ease in and out"


def test_gradients_flow_through_easings(torch):
    for name in ("quint_in", "ease", "bounce_out", "elastic_in_out"):
        u = torch.tensor([0.0, 0.2, 0.6, 0.9], dtype=torch.float64, requires_grad=True)
        ease.ease(name, u).sum().backward()
        assert bool(torch.isfinite(u.grad).all())
    u = torch.tensor([0.2, 0.6], dtype=torch.float64, requires_grad=True)
    ease.ease("quint_in", u).sum().backward()
    np.testing.assert_allclose(u.grad.numpy(), ease.easing("quint_in").slope(u.detach().numpy()))


@pytest.mark.browser
def test_a_browser_computes_the_same_css_easings():
    """Chromium's own animations as the reference: the progress that Web Animations state."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not Path("/usr/bin/chromium").is_file():
        pytest.skip("Chromium is missing")
    texts = ["ease", "ease-in", "ease-out", "ease-in-out", "cubic-bezier(0, 1, 1, 0)", "cubic-bezier(1, 0, 0, 1)",
             "cubic-bezier(0, -2, 1, 3)", "cubic-bezier(0.1, 2, 0.9, -1)", "cubic-bezier(0, 0, 1, 1)",
             "steps(4, jump-end)", "steps(4, jump-start)", "steps(4, jump-none)", "steps(4, jump-both)", "steps(1)"]  # fmt: skip
    u = np.array([0, 0.003, 0.1, 0.25, 0.4, 0.5, 0.7, 0.75, 0.9, 0.999, 1.0])
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        page = browser.new_page()
        found = page.evaluate(
            """([texts, us]) => texts.map(easing => {
              const effect = new KeyframeEffect(document.body, null, { duration: 1000, easing, fill: "both" });
              const animation = new Animation(effect);
              return us.map(u => { animation.currentTime = 1000 * u; return effect.getComputedTiming().progress; });
            })""",
            [texts, u.tolist()],
        )
        browser.close()
    for text, expected in zip(texts, found, strict=True):
        # the browser itself solves its curves to a millionth or so
        np.testing.assert_allclose(
            ease.ease(text, u), expected, atol=2e-5 if "steps" not in text else 1e-9, err_msg=text
        )
