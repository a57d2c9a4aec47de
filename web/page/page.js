// The page: a worker trains, and this thread plays the policy and draws.
const element = id => document.getElementById(id);
const FALLEN_PAUSE = 0.8;
const MAP_SIZE = 48;

// Longest message that is shown, in characters, and how long a worker has to answer, in milliseconds.
const MAX_MESSAGE = 600;
const PATIENCE = 300;

let module = null;
let worker = null;
let workerUrl = null;
let player = null;
// What the environment says of itself: limits, threshold, axes of the map.
let task = null;
let moduleName = '';
// Waits for the answer to a pause.
let patience = 0;
// The run: its config as the trainer describes it, what it has reported, and the evaluations of the run before. `snapshot` is where an
// evaluation begins that has not ended.
let run = { number: 0 };
let training = false;
// The policy that plays: null for the one in training, or the name of a file.
let file = null;
let playing = !matchMedia('(prefers-reduced-motion: reduce)').matches;
const episode = { moment: { state: [0, 0, 0, 0], action: null, steps: 0 }, seed: 0, push: 0, pushed: 0, pause: 0 };
let mapShown = { image: null, at: 0 };

const send = message => worker.postMessage(message);

// The fastest module that this browser can run.
async function loadModule() {
  for (const script of document.querySelectorAll('[data-module]')) {
    const packed = unpacked(script.textContent, Number(script.dataset.size));
    const bytes = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'))).arrayBuffer();
    script.remove();
    if (WebAssembly.validate(bytes)) {
      moduleName = script.dataset.module;
      return WebAssembly.compile(bytes);
    }
  }
  throw new Error('this browser runs none of the WebAssembly modules of this page; a newer one does');
}

function problem(message) {
  element('message').hidden = !message;
  element('problem').textContent = message?.length > MAX_MESSAGE ? `${message.slice(0, MAX_MESSAGE)} …` : message ?? '';
}

// A worker that knows no run, in the place of the one before, which may be busy for long.
function makeWorker() {
  if (worker) {
    worker.onmessage = worker.onerror = null;
    worker.terminate();
  }
  workerUrl ??= URL.createObjectURL(new Blob([element('worker').textContent], { type: 'text/javascript' }));
  worker = new Worker(workerUrl);
  worker.onmessage = ({ data }) => data.run === run.number && handlers[data.type](data);
  worker.onerror = event => problem(`The training has stopped: ${event.message}`);
  send({ type: 'module', module });
}

function begin() {
  makeWorker();
  const { number, input, snapshot, seconds } = run;
  send({ type: 'start', run: number, input, snapshot, seconds });
}

// Begins the run of the settings anew.
function start({ keepTraining = training } = {}) {
  const before = run.evaluations?.length > 2 ? run.evaluations : run.before;
  run = {
    number: run.number + 1, config: run.config, evaluations: [], statistics: [], episodes: [],
    epsilons: [], failure: null, refused: false, snapshot: null, before,
    state: { env_steps: 0, updates: 0, end: null }, seconds: 0, solvedSeconds: null,
    input: { name: settings.preset ?? 'config.json', text: settings.text, sets: setList() },
  };
  problem(null);
  begin();
  setTraining(keepTraining);
  history.replaceState(null, '', toFragment());
  // There is a command once the trainer has accepted the settings.
  showCommand('');
  element('undo').disabled = ![...settings.sets.keys()].some(key => key !== 'seed');
}

function setTraining(on) {
  training = on;
  element('train').textContent = on ? 'Pause' : 'Train';
  clearTimeout(patience);
  send(on ? { type: 'run', speed: Number(element('speed').value) } : { type: 'pause' });
  if (!on) patience = setTimeout(giveUpEvaluation, PATIENCE);
}

// A worker that evaluates does not hear that it should pause. Another one takes the run from before the evaluation.
function giveUpEvaluation() {
  if (!training && run.snapshot) begin();
}

function showCommand(command) {
  element('command').textContent = command;
  element('command').hidden = !command;
  element('same').hidden = run.refused;
  element('none').hidden = !run.refused;
}

const handlers = {
  started({ description }) {
    run.config = description.config;
    element('version').textContent = `cartpole-dqn ${description.version}, kernels for ${description.instruction_set}.`;
    element('config').value = description.text;
    element('seed').value = run.config.seed;
    showCommand(commandLine());
    showControls();
  },
  paused() { clearTimeout(patience); },
  trained({ state, seconds, policy, snapshot }) {
    Object.assign(run, { state, seconds, snapshot });
    for (const event of state.events) {
      if (event.event === 'evaluation') run.evaluations.push(event);
      if (event.event === 'statistics') run.statistics.push(event);
      if (event.event === 'episode') run.episodes.push(event);
    }
    if (run.solvedSeconds === null && state.solved_at_step !== null && state.solved_at_step !== undefined) run.solvedSeconds = seconds;
    if (state.end && training) {
      training = false;
      element('train').textContent = 'Train';
    }
    run.epsilons.push([state.env_steps, state.epsilon]);
    run.policy = policy;
    if (file === null) playPolicy(policy);
    showRun();
  },
  failed({ message }) {
    training = false;
    element('train').textContent = 'Train';
    if (run.state.env_steps) {
      run.failure = message;
    } else {
      run.refused = true;
      problem(`These settings give no run. ${message}`);
      showCommand('');
      // What can be edited is what was given, and not the config of the run before.
      element('config').value = settings.text.trim();
      element('preset').value = settings.preset ?? '';
      element('seed').value = settings.sets.get('seed') ?? '';
      if (file === null) element('source').textContent = '';
    }
    showRun();
  },
  file({ name, bytes }) {
    save(`${name}.safetensors`, bytes, 'application/octet-stream');
  },
};

function save(name, content, type) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(new Blob([content], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

function playPolicy(bytes) {
  const description = player.json('load', bytes);
  const { env_steps: steps } = description;
  element('source').textContent = file
    ? `Plays the policy of ${file}${steps === null ? '' : `, after ${number(steps)} steps of training`}.`
    : `Plays the greedy policy as it is now, after ${number(steps)} steps of training. Push the cart with ← and →.`;
  if (episode.moment.q_values === undefined) episode.moment = player.json('reset', null, episode.seed);
  if (performance.now() - mapShown.at > 200 || run.state.end || file || !run.state.env_steps) showMap();
}

// Whether there is a policy that can play.
const canPlay = () => Boolean(file ?? run.policy);

// Asks the policy for its preferences, and draws them.
function showMap() {
  if (!canPlay()) return;
  const preferences = new Float32Array(player.bytes('map', null, MAP_SIZE).buffer);
  mapShown = { image: mapImage(preferences), at: performance.now() };
  drawMap(element('map'), mapShown.image, episode.moment.state);
}

// One step of the episode that is shown.
function playStep() {
  if (episode.pause > 0) {
    episode.pause -= 1;
    if (episode.pause === 0) {
      episode.seed += 1;
      episode.moment = player.json('reset', null, episode.seed);
    }
    return;
  }
  episode.moment = player.json('step', null, episode.push);
  if (episode.push) episode.pushed = { side: episode.push, left: 12 };
  episode.push = 0;
  if (episode.pushed && --episode.pushed.left <= 0) episode.pushed = null;
  if (episode.moment.terminated) episode.pause = FALLEN_PAUSE * task.steps_per_second;
}

function push(side) {
  if (!canPlay()) return;
  episode.push = side;
  if (playing) return;
  playStep();
  showEpisode();
}

function showEpisode() {
  const { state, action, steps, terminated, q_values: q } = episode.moment;
  drawCart(element('cart'), state, action, episode.pushed?.side ?? 0);
  const end = Math.abs(state[0]) > task.max_position ? 'The cart left the track' : 'The pole fell';
  element('standing').textContent = terminated ? `${end} after ${number(steps)} steps.` : `The pole stands: ${number(steps)} steps${steps >= task.max_steps ? ` (an evaluation ends at ${task.max_steps})` : ''}.`;
  element('gap').textContent = q ? `It expects ${rounded(Math.abs(q[1] - q[0]))} more of the push to the ${action ? 'right' : 'left'}.` : '';
  const largest = Math.max(...(q ?? [1]).map(Math.abs), 1e-9);
  (q ?? [null, null]).forEach((value, i) => {
    element(`bar${i}`).style.width = value === null ? 0 : `${Math.max(0, 100 * value / largest)}%`;
    element(`q${i}`).textContent = value === null ? '' : Math.abs(value) < 1e6 ? number(value, Math.abs(value) < 10 ? 3 : 1) : rounded(value);
    element(`name${i}`).className = action === i ? 'chosen' : '';
  });
}

let before = performance.now();
let owed = 0;
function frame(now) {
  requestAnimationFrame(frame);
  // After a pause of the tab it goes on where it was.
  owed = Math.min(owed + (now - before) / 1000 * task.steps_per_second, 10);
  before = now;
  if (!canPlay() || !playing) {
    owed = 0;
    return;
  }
  if (owed < 1) return;
  for (; owed >= 1; owed -= 1) playStep();
  showEpisode();
  if (mapShown.image) drawMap(element('map'), mapShown.image, episode.moment.state);
}

function rightEnd() {
  if (run.state.end) return Math.max(run.state.env_steps, run.before?.at(-1)?.env_steps ?? 0);
  const { steps } = run.config?.budget ?? {};
  return steps ? Number(steps) : Math.max(1000, ...run.episodes.slice(-1).map(one => 1.05 * one.env_steps));
}

function showRun() {
  const { state, seconds } = run;
  const speed = seconds > 0.2 ? `, ${number(state.updates / seconds)} updates a second` : '';
  const end = state.end ? 'The run has ended. ' : '';
  element('where').textContent = `${end}${number(state.env_steps)} steps, ${number(state.updates)} updates${speed}`;
  element('train').disabled = element('more').disabled = Boolean(state.end || run.failure || run.refused);
  element('last').disabled = run.refused;
  element('best').disabled = !run.evaluations.length;
  element('hashed').textContent = number(state.env_steps);
  element('sha256').textContent = state.weights_sha256 ?? '';
  showStory();
  showPlots();
}

function showStory() {
  const lines = run.config || run.refused ? story(run) : [];
  const shown = lines.join('\n');
  // Screen readers read what changes.
  if (element('story').dataset.shown === shown) return;
  element('story').dataset.shown = shown;
  element('story').replaceChildren(...lines.map(line => Object.assign(document.createElement('p'), { textContent: line })));
}

function showPlots() {
  const right = rightEnd();
  const evaluations = run.evaluations.map(one => [one.env_steps, one.mean]);
  const previous = (run.before ?? []).map(one => [one.env_steps, one.mean]);
  element('before').hidden = !previous.length;
  drawPlot(element('curve'), {
    right, y: task.return_range, labels: true, line: { y: task.solved_return, text: 'solved' },
    band: run.evaluations.map(one => [one.env_steps, one.min, one.max]),
    curves: [
      { points: previous, colour: style('--muted'), dash: [1.5, 3] },
      { points: run.episodes.map(one => [one.env_steps, one.mean_return_100]), colour: `rgb(${style('--right')})`, dash: [5, 3] },
      { points: evaluations, colour: style('--accent'), dots: true },
    ],
  });
  const latest = run.evaluations.at(-1);
  element('curve').ariaLabel = latest ? `Learning curve: a mean return of ${rounded(latest.mean)} after ${number(latest.env_steps)} steps` : 'Learning curve: nothing yet';
  const small = (id, points, y, logarithmic) => {
    drawPlot(element(id), { right, y, logarithmic, curves: [{ points, colour: style('--accent') }] });
    const value = points.length ? rounded(points.at(-1)[1]) : '';
    element(`now_${id}`).textContent = value;
    element(id).ariaLabel = `${id === 'epsilon' ? 'Exploration' : id === 'loss' ? 'Loss' : 'Q-value'}: ${value || 'nothing yet'}`;
  };
  small('epsilon', run.epsilons, [0, 1]);
  const losses = run.episodes.filter(one => one.loss > 0).map(one => [one.env_steps, one.loss]);
  const powers = losses.map(([, loss]) => Math.log10(loss));
  small('loss', losses, losses.length ? [10 ** Math.floor(Math.min(...powers)), 10 ** Math.floor(Math.max(...powers) + 1)] : [0.01, 1], true);
  const values = run.statistics.filter(one => 'max_q' in one).map(one => [one.env_steps, one.max_q]);
  small('max_q', values, [0, Math.max(1, ...values.map(([, value]) => value)) * 1.1]);
  element('rows').replaceChildren(...run.evaluations.map(one => {
    const row = document.createElement('tr');
    for (const value of [one.env_steps, one.mean, one.min, one.max]) row.insertCell().textContent = number(value, 1);
    return row;
  }));
}

// The sliders and switches, as the config has them.
function showControls() {
  const { config } = run;
  for (const { id, get, label, values } of SLIDERS) {
    const value = get(config);
    const slider = element(`slider-${id}`);
    slider.parentElement.hidden = value === undefined;
    if (value === undefined) continue;
    const list = typeof values === 'function' ? values(config) : values;
    slider.list_ = [...new Set([...list, value])].sort((a, b) => (a < b ? -1 : 1));
    slider.max = slider.list_.length - 1;
    slider.value = slider.list_.indexOf(value);
    element(`label-${id}`).textContent = label(config);
    showValue(slider, value);
  }
  for (const { id, get } of SWITCHES) {
    const value = get(config);
    element(`switch-${id}`).parentElement.hidden = value === undefined;
    element(`switch-${id}`).checked = Boolean(value);
  }
  element('preset').value = settings.preset ?? '';
}

function showValue(slider, value) {
  const text = value >= 1000 ? number(value) : String(value);
  slider.nextElementSibling.textContent = text;
  slider.ariaValueText = text;
}

function makeControls() {
  for (const { id, put } of SLIDERS) {
    const label = document.createElement('label');
    label.hidden = true;
    label.innerHTML = `<span id="label-${id}"></span><input type="range" id="slider-${id}" min="0"><output></output>`;
    const slider = label.querySelector('input');
    // The value stands above the slider, at the right.
    slider.addEventListener('input', () => showValue(slider, slider.list_[slider.value]));
    slider.addEventListener('change', () => change(() => put(slider.list_[slider.value], run.config)));
    element('sliders').append(label);
  }
  for (const { id, label: text, put } of SWITCHES) {
    const label = document.createElement('label');
    label.hidden = true;
    label.innerHTML = `<input type="checkbox" id="switch-${id}">${text}`;
    const box = label.querySelector('input');
    box.addEventListener('change', () => change(() => put(box.checked, run.config)));
    element('switches').append(label);
  }
  // The steps from the tutorial to the default are a group of their own: "05 target policy" is ladder/05_target_policy.
  const ladder = document.createElement('optgroup');
  ladder.label = 'From the tutorial to the default';
  for (const { dataset: { preset: name } } of presets()) {
    if (name.startsWith('ladder/')) ladder.append(new Option(name.slice('ladder/'.length).replaceAll('_', ' '), name));
    else element('preset').add(new Option(PRESETS[name], name));
  }
  element('preset').add(ladder);
  const own = new Option('an edited config', '');
  own.hidden = true;
  element('preset').add(own);
}

function change(action) {
  action();
  start();
}

function listen() {
  const on = (id, event, action) => element(id).addEventListener(event, action);
  on('train', 'click', () => setTraining(!training));
  on('more', 'click', () => send({ type: 'more', steps: 100 }));
  on('reset', 'click', () => start({ keepTraining: false }));
  on('close', 'click', () => problem(null));
  on('preset', 'change', event => change(() => choosePreset(event.target.value)));
  on('seed', 'change', event => change(() => set('seed', event.target.value.trim() || '0')));
  on('speed', 'change', () => training && setTraining(true));
  on('undo', 'click', () => change(() => settings.preset ? choosePreset(settings.preset) : settings.sets.clear()));
  on('play', 'click', () => setPlaying(!playing));
  on('left', 'click', () => push(-1));
  on('right', 'click', () => push(1));
  on('best', 'click', () => send({ type: 'file', name: 'best' }));
  on('last', 'click', () => send({ type: 'file', name: 'last' }));
  on('save', 'click', () => save('config.json', `${element('config').value}\n`, 'application/json'));
  on('use', 'click', useConfig);
  on('link', 'click', copyLink);
  on('current', 'click', () => {
    file = null;
    element('current').hidden = true;
    element('source').textContent = '';
    if (run.policy) playPolicy(run.policy);
  });
  on('file', 'change', event => event.target.files[0] && playFile(event.target.files[0]));
  addEventListener('hashchange', () => change(() => fromFragment(location.hash)));
  addEventListener('keydown', event => {
    const side = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!side || event.target.closest('input, select, textarea')) return;
    event.preventDefault();
    push(side);
  });
  addEventListener('dragover', event => { event.preventDefault(); element('drop').classList.add('over'); });
  addEventListener('dragleave', () => element('drop').classList.remove('over'));
  addEventListener('drop', event => {
    event.preventDefault();
    element('drop').classList.remove('over');
    if (event.dataTransfer.files[0]) playFile(event.dataTransfer.files[0]);
  });
  const redraw = () => {
    drawColours(element('colours'));
    showPlots();
    showEpisode();
    showMap();
  };
  new ResizeObserver(redraw).observe(element('cart'));
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', redraw);
}

function setPlaying(on) {
  playing = on;
  element('play').textContent = on ? 'Pause' : 'Play';
}

function useConfig() {
  try {
    JSON.parse(element('config').value);
  } catch (error) {
    problem(`The config is not JSON: ${error.message}`);
    return;
  }
  change(() => Object.assign(settings, { preset: null, text: element('config').value, sets: new Map() }));
}

async function copyLink() {
  const label = element('link').textContent;
  try {
    await navigator.clipboard.writeText(location.href);
    element('link').textContent = 'Copied';
  } catch {
    element('link').textContent = 'The address bar has the link';
  }
  setTimeout(() => { element('link').textContent = label; }, 2000);
}

async function playFile(chosen) {
  const previous = file;
  try {
    const bytes = new Uint8Array(await chosen.arrayBuffer());
    // Nothing plays while a file is read: there may be no policy yet.
    file = chosen.name;
    playPolicy(bytes);
    problem(null);
    element('current').hidden = false;
    // The pole that plays may be far above the place where the file was dropped.
    element('plays').scrollIntoView();
  } catch (error) {
    file = previous;
    problem(`${chosen.name} cannot be played: ${error.message}`);
  }
}

async function main() {
  module = await loadModule();
  player = await instantiate(module);
  task = player.json('task');
  fromFragment(location.hash);
  makeControls();
  setPlaying(playing);
  start({ keepTraining: false });
  listen();
  requestAnimationFrame(frame);
}

main().catch(error => problem(`The page cannot train: ${error.message}`));
