'use strict';
const { runs } = JSON.parse(document.getElementById('data').textContent);
const element = id => document.getElementById(id);
if (element('policy')) show(runs.filter(run => run.portrait));

function show(runs) {
  let policy = runs[0].portrait;
  // The moment that is shown, in steps; between two steps the drawing is interpolated.
  let moment = 0;
  let playing = false;
  let before = 0;

  const style = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const last = () => policy.episode.actions.length;
  // Values of a small range need more digits.
  const shown = (value, range = 100) =>
    value.toFixed(range < 1 ? 4 : Math.abs(value) < 10 ? 2 : 1).replace('-', '−');

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
    const { drawing, width } = context(element('scene'));
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

  const ACTION_COLOURS = ['--left', '--action-1', '--action-2', '--action-3', '--right'];
  // The first action has the colour of "left", the last that of "right".
  function colour(action) {
    const isLast = action > 0 && action === policy.actions.length - 1;
    return style(isLast ? '--right' : ACTION_COLOURS[action % ACTION_COLOURS.length]);
  }

  // The map as an image of its own, until the policy or the colours change.
  let image = null;
  const opacity = share => 0.08 + 0.92 * Math.min(share, 1);

  // The visits of a table's cells, as an image too.
  let visitsImage = null;

  // One pixel for each point of the map.
  function rendered(pixel) {
    const { size } = policy.map;
    const rendered = document.createElement('canvas');
    rendered.width = rendered.height = size;
    const drawing = rendered.getContext('2d');
    const pixels = drawing.createImageData(size, size);
    for (let i = 0; i < size * size; i++) {
      // The first row is the smallest value, at the bottom.
      pixels.data.set(pixel(i), 4 * ((size - 1 - Math.floor(i / size)) * size + (i % size)));
    }
    drawing.putImageData(pixels, 0, 0);
    return rendered;
  }

  function renderMap() {
    const { best, gap, table } = policy.map;
    // The gap at which a colour is full: that of 95 % of the map.
    const full = [...gap].sort((a, b) => a - b)[Math.floor(0.95 * (gap.length - 1))] || 1;
    const colours = policy.actions.map((_, action) => colour(action).split(',').map(Number));
    image = rendered(i => [...colours[best[i]], 255 * opacity(gap[i] / full)]);
    if (!table) return;
    const most = Math.log1p(Math.max(...table.visits)) || 1;
    const ink = style('--right').split(',').map(Number);
    visitsImage = rendered(i => [...ink, 255 * Math.log1p(table.visits[i]) / most]);
  }

  const MARGIN = { left: 58, right: 8, top: 8, bottom: 38 };
  const share = (value, { low, high }) => (value - low) / (high - low);
  const mapPlace = (x, y, width, height) => [
    MARGIN.left + share(x, policy.map.axes[0]) * (width - MARGIN.left - MARGIN.right),
    MARGIN.top + (1 - share(y, policy.map.axes[1])) * (height - MARGIN.top - MARGIN.bottom),
  ];

  // Round numbers within an axis, at most seven.
  function ticks({ low, high }) {
    const least = (high - low) / 6;
    const power = 10 ** Math.floor(Math.log10(least));
    const step = [1, 2, 5, 10].map(factor => factor * power).find(step => step >= least);
    const numbers = [];
    for (let i = Math.ceil(low / step); i <= Math.floor(high / step); i++) numbers.push(Number((i * step).toPrecision(6)));
    return numbers;
  }

  // Degrees stand at every number, another unit behind the name of the axis.
  const tickText = (value, { unit }) => String(value).replace('-', '−') + (unit === '°' ? unit : '');
  const axisTitle = ({ name, unit }) => (unit && unit !== '°' ? `${name}, ${unit.trim()}` : name);

  // Whether an angle went past ±180° between two values of an axis.
  const isJump = (a, b, { low, high }) => Math.abs(b - a) > (high - low) / 2;

  function drawTrail(drawing, width, height) {
    const { trail: [xs, ys], axes } = policy.map;
    drawing.strokeStyle = style('--ink');
    drawing.globalAlpha = 0.4;
    drawing.beginPath();
    xs.forEach((x, i) => {
      const jumps = i > 0 && (isJump(xs[i - 1], x, axes[0]) || isJump(ys[i - 1], ys[i], axes[1]));
      drawing[jumps ? 'moveTo' : 'lineTo'](...mapPlace(x, ys[i], width, height));
    });
    drawing.stroke();
    drawing.globalAlpha = 1;
    const step = Math.min(Math.floor(moment), last());
    const now = [xs, ys].map((series, i) =>
      isJump(series[step], series[Math.min(step + 1, last())], axes[i]) ? series[step] : between(series));
    drawing.fillStyle = style('--ink');
    drawing.strokeStyle = style('--paper');
    drawing.lineWidth = 2;
    drawing.beginPath();
    drawing.arc(...mapPlace(...now, width, height), 6, 0, 2 * Math.PI);
    drawing.fill();
    drawing.stroke();
  }

  // The edges of a table's cells.
  function drawEdges(drawing, width, height) {
    const { axes: [horizontal, vertical], table: { edges: [xs, ys] } } = policy.map;
    drawing.strokeStyle = style('--muted');
    drawing.lineWidth = 0.5;
    drawing.beginPath();
    for (const x of xs) {
      drawing.moveTo(...mapPlace(x, vertical.low, width, height));
      drawing.lineTo(...mapPlace(x, vertical.high, width, height));
    }
    for (const y of ys) {
      drawing.moveTo(...mapPlace(horizontal.low, y, width, height));
      drawing.lineTo(...mapPlace(horizontal.high, y, width, height));
    }
    drawing.stroke();
  }

  function drawMap() {
    if (!policy.map) return;
    if (!image) renderMap();
    drawPlane('map', image);
    if (policy.map.table) drawPlane('visits', visitsImage);
  }

  function drawPlane(id, image) {
    const { drawing, width, height } = context(element(id));
    const [horizontal, vertical] = policy.map.axes;
    const [left, top] = mapPlace(horizontal.low, vertical.high, width, height);
    const [right, bottom] = mapPlace(horizontal.high, vertical.low, width, height);
    drawing.imageSmoothingEnabled = !policy.map.table;
    drawing.drawImage(image, left, top, right - left, bottom - top);
    drawing.font = '12px system-ui, sans-serif';
    drawing.fillStyle = style('--muted');
    drawing.strokeStyle = style('--muted');
    drawing.lineWidth = 1;
    drawing.strokeRect(left, top, right - left, bottom - top);
    drawing.textAlign = 'center';
    for (const value of ticks(horizontal)) {
      const [x] = mapPlace(value, vertical.low, width, height);
      drawing.fillText(tickText(value, horizontal), x, bottom + 15);
    }
    drawing.fillText(axisTitle(horizontal), (left + right) / 2, bottom + 31);
    drawing.textAlign = 'right';
    for (const value of ticks(vertical)) {
      const [, y] = mapPlace(horizontal.low, value, width, height);
      drawing.fillText(tickText(value, vertical), left - 5, y + 4);
    }
    drawing.save();
    drawing.translate(12, (top + bottom) / 2);
    drawing.rotate(-Math.PI / 2);
    drawing.textAlign = 'center';
    drawing.fillText(axisTitle(vertical), 0, 0);
    drawing.restore();

    drawing.save();
    drawing.beginPath();
    drawing.rect(left, top, right - left, bottom - top);
    drawing.clip();
    if (policy.map.table) drawEdges(drawing, width, height);
    drawTrail(drawing, width, height);
    drawing.restore();
  }

  // A name and a scale for each action. Of two actions the second scale is the mirror image of the first.
  function drawColours() {
    const scales = policy.actions.map((name, action) => {
      const isMirrored = policy.actions.length === 2 && action === 1;
      const [label, scale] = [document.createElement('span'), document.createElement('i')];
      label.textContent = name;
      const [faint, full] = [0, 1].map(share => `rgba(${colour(action)}, ${opacity(share)})`);
      scale.style.background = `linear-gradient(to ${isMirrored ? 'right' : 'left'}, ${faint}, ${full})`;
      return isMirrored ? [scale, label] : [label, scale];
    });
    element('colours').replaceChildren(...scales.flat());
  }

  const expected = values => values.map((value, i) => `${policy.actions[i]} ${shown(value)}`).join(', ');

  function draw() {
    drawScene();
    drawMap();
    const step = Math.floor(moment);
    element('scrub').value = step;
    const { actions, q_values, total, ending } = policy.episode;
    const time = `step ${step} of ${last()}, ${(step / policy.steps_per_second).toFixed(2)} s`;
    const doing = step < actions.length
      ? `takes ${policy.actions[actions[step]]}; expected return: ${expected(q_values[step])}`
      : `the end: return ${String(total).replace('-', '−')}${ending && `, ${ending}`}`;
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
    element('plane').hidden = element('plane-note').hidden = !policy.map;
    element('visited').hidden = !policy.map?.table;
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
    const { size, axes, best, gap } = policy.map;
    const index = (value, low, high) => Math.round(share(value, { low, high }) * (size - 1));
    const column = index(event.clientX - left, MARGIN.left, width - MARGIN.right);
    const row = index(event.clientY - top, height - MARGIN.bottom, MARGIN.top);
    if (column < 0 || row < 0 || column >= size || row >= size) return;
    const [x, y] = [column, row].map((i, axis) => {
      const { low, high, unit } = axes[axis];
      return shown(low + (high - low) * i / (size - 1), high - low) + unit;
    });
    const point = row * size + column;
    element('value').textContent = `${x}, ${y}: ${policy.actions[best[point]]} is best, action gap ${shown(gap[point])}`;
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
  new ResizeObserver(redraw).observe(element('scene'));
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', redraw);
  choose(runs[0]);
}
