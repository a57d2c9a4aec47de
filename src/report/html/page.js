'use strict';
const { runs } = JSON.parse(document.getElementById('data').textContent);
const element = id => document.getElementById(id);
if (element('policy')) show(runs.filter(run => run.portrait));

function show(runs) {
  const ANGLES = [-10, -5, 0, 5, 10];
  const VELOCITIES = [-100, -50, 0, 50, 100];
  const DEGREES = 180 / Math.PI;
  let policy = runs[0].portrait;
  // The moment that is shown, in steps; between two steps the drawing is interpolated.
  let moment = 0;
  let playing = false;
  let before = 0;

  const style = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const last = () => policy.episode.actions.length;
  const shown = value => value.toFixed(Math.abs(value) < 10 ? 2 : 1).replace('-', '−');

  // The context of a canvas in CSS pixels, whatever the screen's.
  function context(canvas) {
    const { width, height } = canvas.getBoundingClientRect();
    const scale = window.devicePixelRatio || 1;
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
    const drawing = canvas.getContext('2d');
    drawing.scale(scale, scale);
    return { drawing, width, height };
  }

  // A series that never changes has one value.
  function between(series) {
    const step = Math.min(Math.floor(moment), series.length - 1);
    const next = Math.min(step + 1, series.length - 1);
    return series[step] + (series[next] - series[step]) * (moment - step);
  }

  // The shapes of a 600 × 400 picture, whose heights count upwards; without a picture the numbers of the state.
  function drawScene() {
    const { drawing, width } = context(element('cart'));
    drawing.scale(width / 600, width / 600);
    drawing.lineWidth = 1;
    const { shapes, state } = policy.episode;
    if (!shapes.length) {
      drawing.fillStyle = style('--ink');
      drawing.font = '20px system-ui, sans-serif';
      state.forEach((series, i) => drawing.fillText(`${policy.coordinates[i] ?? i}: ${shown(between(series))}`, 20, 30 * (i + 1)));
    }
    for (const { color, polygon, radius, line, x, y, angle } of shapes) {
      drawing.save();
      drawing.translate(between(x), 400 - between(y));
      drawing.scale(1, -1);
      drawing.rotate(between(angle));
      drawing.strokeStyle = drawing.fillStyle = style(`--${color}`);
      drawing.beginPath();
      if (radius) drawing.arc(0, 0, radius, 0, 2 * Math.PI);
      for (const point of polygon ?? line ?? []) drawing.lineTo(...point);
      if (line) drawing.stroke();
      else drawing.fill();
      drawing.restore();
    }
  }

  // The map as an image of its own, until the policy or the colours change.
  let image = null;
  const opacity = share => 0.08 + 0.92 * Math.min(share, 1);

  function renderMap() {
    // The gap at which a colour is full: that of 95 % of the map.
    const gaps = policy.preference.map(Math.abs).sort((a, b) => a - b);
    const full = gaps[Math.floor(0.95 * (gaps.length - 1))] || 1;
    const { size, preference } = policy;
    image = document.createElement('canvas');
    image.width = image.height = size;
    const drawing = image.getContext('2d');
    const pixels = drawing.createImageData(size, size);
    const colours = ['--left', '--right'].map(name => style(name).split(',').map(Number));
    preference.forEach((value, i) => {
      // The first row is the smallest velocity, at the bottom.
      const pixel = 4 * ((size - 1 - Math.floor(i / size)) * size + (i % size));
      pixels.data.set([...colours[value < 0 ? 0 : 1], 255 * opacity(Math.abs(value) / full)], pixel);
    });
    drawing.putImageData(pixels, 0, 0);
  }

  const MARGIN = { left: 48, right: 8, top: 8, bottom: 38 };
  const mapPlace = (angle, velocity, width, height) => [
    MARGIN.left + (angle / policy.max_angle + 1) / 2 * (width - MARGIN.left - MARGIN.right),
    MARGIN.top + (1 - velocity / policy.max_velocity) / 2 * (height - MARGIN.top - MARGIN.bottom),
  ];

  function drawMap() {
    const { drawing, width, height } = context(element('map'));
    const [left, top] = mapPlace(-policy.max_angle, policy.max_velocity, width, height);
    const [right, bottom] = mapPlace(policy.max_angle, -policy.max_velocity, width, height);
    if (!image) renderMap();
    drawing.drawImage(image, left, top, right - left, bottom - top);
    drawing.font = '12px system-ui, sans-serif';
    drawing.fillStyle = style('--muted');
    drawing.strokeStyle = style('--muted');
    drawing.lineWidth = 1;
    drawing.strokeRect(left, top, right - left, bottom - top);
    drawing.textAlign = 'center';
    for (const degrees of ANGLES) {
      const [x] = mapPlace(degrees / DEGREES, 0, width, height);
      drawing.fillText(String(degrees).replace('-', '−') + '°', x, bottom + 15);
    }
    drawing.fillText('pole angle', (left + right) / 2, bottom + 31);
    drawing.textAlign = 'right';
    for (const velocity of VELOCITIES) {
      const [, y] = mapPlace(0, velocity / DEGREES, width, height);
      drawing.fillText(String(velocity).replace('-', '−'), left - 5, y + 4);
    }
    drawing.save();
    drawing.translate(12, (top + bottom) / 2);
    drawing.rotate(-Math.PI / 2);
    drawing.textAlign = 'center';
    drawing.fillText('angular velocity, °/s', 0, 0);
    drawing.restore();

    const [, , angles, velocities] = policy.episode.state;
    drawing.save();
    drawing.beginPath();
    drawing.rect(left, top, right - left, bottom - top);
    drawing.clip();
    drawing.strokeStyle = style('--ink');
    drawing.globalAlpha = 0.4;
    drawing.beginPath();
    angles.forEach((angle, i) => drawing.lineTo(...mapPlace(angle, velocities[i], width, height)));
    drawing.stroke();
    drawing.globalAlpha = 1;
    const [x, y] = mapPlace(between(angles), between(velocities), width, height);
    drawing.fillStyle = style('--ink');
    drawing.strokeStyle = style('--paper');
    drawing.lineWidth = 2;
    drawing.beginPath();
    drawing.arc(x, y, 6, 0, 2 * Math.PI);
    drawing.fill();
    drawing.stroke();
    drawing.restore();
  }

  function drawColours() {
    const { drawing, width, height } = context(element('colours'));
    const columns = Math.max(1, Math.floor(width));
    for (let i = 0; i < columns; i++) {
      const share = 2 * i / columns - 1;
      drawing.fillStyle = `rgba(${style(share < 0 ? '--left' : '--right')}, ${opacity(Math.abs(share))})`;
      drawing.fillRect(i, 0, 1, height);
    }
  }

  const expected = values => values.map((value, i) => `${policy.actions[i]} ${shown(value)}`).join(', ');

  function draw() {
    drawScene();
    drawMap();
    const step = Math.floor(moment);
    element('scrub').value = step;
    const { actions, q_values, state } = policy.episode;
    const [, , angles] = state;
    const time = `step ${step} of ${last()}, ${(step / policy.steps_per_second).toFixed(2)} s`;
    const doing = step < actions.length
      ? `pushes ${policy.actions[actions[step]]}; expected return: ${expected(q_values[step])}`
      : `the end: return ${actions.length}${Math.abs(angles[last()]) > policy.max_angle ? ', the pole fell' : ''}`;
    element('readout').textContent = `${time} — ${doing}`;
  }

  function tick(now) {
    if (!playing) return;
    // A frame's time can lie before the click that asked for it.
    const seconds = Math.max(now - before, 0) / 1000;
    const steps = seconds * policy.steps_per_second * Number(element('speed').value);
    before = now;
    moment = Math.min(moment + steps, last());
    if (moment >= last()) setPlaying(false);
    draw();
    requestAnimationFrame(tick);
  }

  function setPlaying(on) {
    if (on && moment >= last()) moment = 0;
    playing = on;
    element('play').textContent = on ? 'Pause' : 'Play';
    before = performance.now();
    if (on) requestAnimationFrame(tick);
  }

  function choose(run) {
    policy = run.portrait;
    image = null;
    moment = 0;
    element('scrub').max = last();
    const when = policy.env_steps === null ? '' : ` after ${policy.env_steps} steps of training`;
    element('source').textContent =
      `${run.name}: ${policy.checkpoint}${when}. The episode is the one from seed ${policy.episode.seed}, the first that eval plays.`;
    element('value').textContent = 'Point at the map to read its values.';
    drawColours();
    draw();
  }

  element('play').addEventListener('click', () => setPlaying(!playing));
  element('scrub').addEventListener('input', event => {
    moment = Number(event.target.value);
    draw();
  });
  element('map').addEventListener('pointermove', event => {
    const { left, top, width, height } = element('map').getBoundingClientRect();
    const { size, max_angle, max_velocity, preference } = policy;
    const share = (value, low, high) => (value - low) / (high - low);
    const column = Math.round(share(event.clientX - left, MARGIN.left, width - MARGIN.right) * (size - 1));
    const row = Math.round((1 - share(event.clientY - top, MARGIN.top, height - MARGIN.bottom)) * (size - 1));
    if (column < 0 || row < 0 || column >= size || row >= size) return;
    const gap = preference[row * size + column];
    const angle = (2 * column / (size - 1) - 1) * max_angle * DEGREES;
    const velocity = (2 * row / (size - 1) - 1) * max_velocity * DEGREES;
    element('value').textContent =
      `${shown(angle)}°, ${shown(velocity)} °/s: pushes ${policy.actions[gap > 0 ? 1 : 0]}, action gap ${shown(Math.abs(gap))}`;
  });

  if (runs.length > 1) {
    element('choice').hidden = false;
    runs.forEach((run, i) => element('run').add(new Option(run.name, i)));
    element('run').addEventListener('change', event => choose(runs[event.target.value]));
  }
  const redraw = () => {
    image = null;
    drawColours();
    draw();
  };
  new ResizeObserver(redraw).observe(element('cart'));
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', redraw);
  choose(runs[0]);
}
