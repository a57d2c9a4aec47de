// What is drawn on the page's canvases.
const style = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const number = (value, digits = 0) => value.toLocaleString('en', { maximumFractionDigits: digits }).replace('-', '−');
const power = exponent => `10${String(exponent).replace(/./g, digit => (digit === '-' ? '⁻' : '⁰¹²³⁴⁵⁶⁷⁸⁹'[digit]))}`;
// About three digits, whatever the size.
const rounded = value => {
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 1e-3)) {
    const [factor, exponent] = value.toExponential(1).split('e');
    return `${number(Number(factor), 1)} × ${power(Number(exponent))}`;
  }
  return number(value, size < 1 ? 4 : size < 10 ? 2 : size < 100 ? 1 : 0);
};

// The context of a canvas in CSS pixels, whatever the screen's; cleared.
function context(canvas) {
  const { width, height } = canvas.getBoundingClientRect();
  const scale = window.devicePixelRatio || 1;
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const drawing = canvas.getContext('2d');
  drawing.scale(scale, scale);
  return { drawing, width, height };
}

// The picture of Gymnasium's cartpole.py. `push` is the latest blow: 1 from the left, −1 from the right.
function drawCart(canvas, [x, , theta], action, push) {
  const { drawing, width, height } = context(canvas);
  const METRE = 125, TRACK = 60, AXLE = 7.5;
  drawing.scale(width / 600, width / 600);
  drawing.translate(300, height / (width / 600) - TRACK);
  drawing.strokeStyle = style('--muted');
  drawing.lineWidth = 1.5;
  drawing.beginPath();
  drawing.moveTo(-300, 0);
  drawing.lineTo(300, 0);
  // The ends of the track, beyond which an episode ends.
  for (const end of [-299, 299]) {
    drawing.moveTo(end, -14);
    drawing.lineTo(end, 14);
  }
  drawing.stroke();
  drawing.translate(x * METRE, 0);
  drawing.fillStyle = style('--ink');
  drawing.fillRect(-25, -15, 50, 30);
  const arrow = (side, size, colour) => {
    drawing.fillStyle = colour;
    drawing.beginPath();
    drawing.moveTo(-side * 30, 0);
    drawing.lineTo(-side * (30 + size), -size * 0.6);
    drawing.lineTo(-side * (30 + size), size * 0.6);
    drawing.fill();
  };
  if (push) arrow(push, 36, style('--bad'));
  else if (action !== null) arrow(action ? 1 : -1, 13, `rgb(${style(action ? '--right' : '--left')})`);
  drawing.translate(0, -AXLE);
  drawing.save();
  drawing.rotate(theta);
  drawing.fillStyle = style('--tan');
  drawing.fillRect(-5, -METRE + 5, 10, METRE);
  drawing.restore();
  drawing.fillStyle = style('--lavender');
  drawing.beginPath();
  drawing.arc(0, 0, 5, 0, 2 * Math.PI);
  drawing.fill();
}

// A round distance between the marks of an axis up to `top`, for at most `count` of them after 0.
function spacing(top, count = 5) {
  const least = 10 ** Math.floor(Math.log10(top / count || 1));
  return least * [1, 2, 2.5, 5, 10].find(factor => factor * least >= top / count);
}

// Curves over environment steps. A curve is { points: [[x, y]], colour, dash }; `band` is [[x, low, high]]. `y` is [low, high].
function drawPlot(canvas, { right, y: [low, high], curves, band = [], line, logarithmic, labels }) {
  const { drawing, width, height } = context(canvas);
  const margin = { left: 46, right: 10, top: 10, bottom: labels ? 34 : 18 };
  const bottom = height - margin.bottom;
  const map = logarithmic ? Math.log10 : value => value;
  const px = x => margin.left + x / right * (width - margin.left - margin.right);
  const py = y => bottom - (map(y) - map(low)) / (map(high) - map(low)) * (bottom - margin.top);
  drawing.font = '12px system-ui, sans-serif';
  drawing.lineWidth = 1;
  const round = Array.from({ length: 12 }, (_, i) => i * spacing(high)).filter(y => y <= high);
  // A small plot has room for two.
  const marks = logarithmic ? [low, high] : labels ? round : [0, round.at(-1)];
  drawing.textAlign = 'right';
  for (const mark of marks) {
    drawing.strokeStyle = style('--line');
    drawing.beginPath();
    drawing.moveTo(margin.left, py(mark));
    drawing.lineTo(width - margin.right, py(mark));
    drawing.stroke();
    drawing.fillStyle = style('--muted');
    drawing.fillText(logarithmic ? power(Math.round(Math.log10(mark))) : mark >= 1e6 ? mark.toExponential(0).replace(/e\+?/, 'e') : rounded(mark), margin.left - 5, py(mark) + 4);
  }
  drawing.textAlign = 'center';
  const distance = spacing(right, Math.max(2, Math.floor(width / 75)));
  for (let x = 0; x <= right; x += distance) drawing.fillText(number(x), Math.min(px(x), width - 22), bottom + 15);
  if (labels) drawing.fillText('environment steps', (margin.left + width - margin.right) / 2, bottom + 30);
  drawing.save();
  drawing.beginPath();
  drawing.rect(margin.left, 0, width - margin.left, height);
  drawing.clip();
  if (band.length > 1) {
    drawing.globalAlpha = 0.18;
    drawing.fillStyle = style('--accent');
    drawing.beginPath();
    for (const [x, lowest] of band) drawing.lineTo(px(x), py(lowest));
    for (const [x, , highest] of [...band].reverse()) drawing.lineTo(px(x), py(highest));
    drawing.fill();
    drawing.globalAlpha = 1;
  }
  if (line) {
    drawing.strokeStyle = drawing.fillStyle = style('--muted');
    drawing.setLineDash([2, 4]);
    drawing.beginPath();
    drawing.moveTo(margin.left, py(line.y));
    drawing.lineTo(width, py(line.y));
    drawing.stroke();
    drawing.textAlign = 'right';
    drawing.fillText(line.text, width - margin.right - 4, py(line.y) + 14);
  }
  for (const { points, colour, dash = [], dots } of curves) {
    drawing.strokeStyle = drawing.fillStyle = colour;
    drawing.lineWidth = 2;
    drawing.setLineDash(dash);
    drawing.beginPath();
    for (const [x, y] of points) drawing.lineTo(px(x), py(Math.min(Math.max(y, low), high)));
    drawing.stroke();
    if (dots) for (const [x, y] of points) drawing.fillRect(px(x) - 2, py(y) - 2, 4, 4);
  }
  drawing.restore();
}

const opacity = share => 0.08 + 0.92 * Math.min(share, 1);

// The preferences as an image: strongest where the gap is that of 95 % of the map.
function mapImage(preference) {
  const size = Math.sqrt(preference.length);
  const gaps = Float32Array.from(preference, Math.abs).sort();
  const full = gaps[Math.floor(0.95 * (gaps.length - 1))] || 1;
  const image = document.createElement('canvas');
  image.width = image.height = size;
  const drawing = image.getContext('2d');
  const pixels = drawing.createImageData(size, size);
  const colours = ['--left', '--right'].map(name => style(name).split(',').map(Number));
  preference.forEach((value, i) => {
    // The first row is the lowest velocity, at the bottom.
    const pixel = 4 * ((size - 1 - Math.floor(i / size)) * size + i % size);
    pixels.data.set([...colours[value > 0 ? 1 : 0], 255 * opacity(Math.abs(value) / full)], pixel);
  });
  drawing.putImageData(pixels, 0, 0);
  return image;
}

// The marks of an axis at round distances.
function marks([low, high]) {
  const distance = spacing((high - low) / 2, 3);
  return Array.from({ length: 9 }, (_, i) => (i - 4) * distance).filter(mark => low <= mark && mark <= high);
}

function drawMap(canvas, image, state) {
  const [angle, velocity] = task.map;
  const share = ({ range: [low, high] }, value) => (value - low) / (high - low);
  const { drawing, width, height } = context(canvas);
  const [left, right, top, bottom] = [46, width - 10, 10, height - 36];
  const px = value => left + share(angle, value) * (right - left);
  const py = value => bottom - share(velocity, value) * (bottom - top);
  if (image) drawing.drawImage(image, left, top, right - left, bottom - top);
  drawing.font = '12px system-ui, sans-serif';
  drawing.fillStyle = drawing.strokeStyle = style('--muted');
  drawing.strokeRect(left, top, right - left, bottom - top);
  drawing.textAlign = 'center';
  for (const mark of marks(angle.range)) drawing.fillText(number(mark) + angle.unit, px(mark), bottom + 15);
  drawing.fillText(angle.name, (left + right) / 2, bottom + 31);
  drawing.textAlign = 'right';
  for (const mark of marks(velocity.range)) drawing.fillText(number(mark), left - 5, py(mark) + 4);
  drawing.save();
  drawing.translate(12, (top + bottom) / 2);
  drawing.rotate(-Math.PI / 2);
  drawing.textAlign = 'center';
  drawing.fillText(`${velocity.name},${velocity.unit}`, 0, 0);
  drawing.restore();
  drawing.beginPath();
  drawing.rect(left, top, right - left, bottom - top);
  drawing.clip();
  drawing.beginPath();
  const [x, y] = task.map.map(axis => axis.factor * state[axis.quantity.coordinate]);
  drawing.arc(px(x), py(y), 6, 0, 2 * Math.PI);
  drawing.fillStyle = style('--ink');
  drawing.strokeStyle = style('--paper');
  drawing.lineWidth = 2;
  drawing.fill();
  drawing.stroke();
}

function drawColours(canvas) {
  const { drawing, width, height } = context(canvas);
  for (let x = 0; x < width; x++) {
    const share = 2 * x / width - 1;
    drawing.fillStyle = `rgba(${style(share < 0 ? '--left' : '--right')}, ${opacity(Math.abs(share))})`;
    drawing.fillRect(x, 0, 1, height);
  }
}
