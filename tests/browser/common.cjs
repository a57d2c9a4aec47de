// What the tests in Chromium share.
'use strict';

const CHROMIUM = process.env.CHROMIUM || '/usr/bin/chromium';
const ARGUMENTS = [
  '--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
  '--disable-component-update', '--disable-sync',
];

// What sticks out of the window, unless something around it scrolls.
const outside = () => [...document.querySelectorAll('body *')]
  .filter(element => !element.closest('.scroll, pre, svg') || element.matches('.scroll, pre, svg'))
  .filter(element => {
    const { left, right, width } = element.getBoundingClientRect();
    return width > 0 && (left < -0.5 || right > innerWidth + 0.5);
  })
  .map(element => element.outerHTML.slice(0, 80));

// Contrast of the text of some elements with the page (WCAG 2): the smallest.
const readable = selector => {
  const luminance = colour => {
    const [r, g, b] = colour.match(/[\d.]+/g).map(Number).map(value => value / 255)
      .map(value => (value <= 0.03928 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const paper = luminance(getComputedStyle(document.body).backgroundColor);
  const shown = [...document.querySelectorAll(selector)].filter(element => element.getBoundingClientRect().width > 0);
  const contrasts = shown.map(element => {
    const style = getComputedStyle(element);
    const ink = luminance(element instanceof SVGElement ? style.fill : style.color);
    return (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05);
  });
  return { count: shown.length, contrast: Math.min(...contrasts), paper };
};

module.exports = { CHROMIUM, ARGUMENTS, outside, readable };
