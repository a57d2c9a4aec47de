// The settings of a run: a preset, and what is set on top of it, as `--set key=value` of the command line.
const PRESETS = { cartpole: 'the default', fast: 'fast', plain: 'plain DQN', tutorial: 'the Keras tutorial', q_table: 'Q-table' };
const presets = () => [...document.querySelectorAll('[data-preset]')];
const preset = name => presets().find(({ dataset }) => dataset.preset === name)?.textContent;

const settings = { preset: 'cartpole', text: preset('cartpole'), sets: new Map() };

function choosePreset(name) {
  settings.preset = name;
  settings.text = preset(name);
  const seed = settings.sets.get('seed');
  settings.sets = new Map(seed === undefined ? [] : [['seed', seed]]);
}

const unset = prefix => [...settings.sets.keys()].filter(key => key.startsWith(prefix)).forEach(key => settings.sets.delete(key));
const set = (key, value) => settings.sets.set(key, Array.isArray(value) ? JSON.stringify(value) : String(value));
const setList = () => [...settings.sets].map(([key, value]) => `${key}=${value}`);

// JSON without the spaces between its values, which stay as they are written.
const compact = json => json.replace(/("[^"\\]*(?:\\.[^"\\]*)*")|\s+/g, '$1');

// The link that holds the settings. Those of an edited config are in it whole.
function toFragment() {
  const parts = new URLSearchParams();
  if (settings.preset) parts.set('preset', settings.preset);
  else parts.set('config', compact(settings.text));
  for (const [key, value] of settings.sets) parts.set(key, value);
  return `#${parts}`;
}

function isJson(text) {
  try {
    return typeof JSON.parse(text) === 'object' && text !== null;
  } catch {
    return false;
  }
}

function fromFragment(fragment) {
  const parts = new URLSearchParams(fragment.replace(/^#/, ''));
  const name = parts.get('preset');
  const config = isJson(parts.get('config')) ? parts.get('config') : null;
  settings.preset = config ? null : preset(name) ? name : 'cartpole';
  settings.text = config ?? preset(settings.preset);
  parts.delete('preset');
  parts.delete('config');
  settings.sets = new Map(parts);
}

const quoted = word => (/^[\w.,:=/+-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

function commandLine() {
  const words = ['cartpole-dqn', 'train'];
  if (settings.preset !== 'cartpole') words.push('--config', settings.preset ?? 'config.json');
  for (const [key, value] of settings.sets) words.push(...(key === 'seed' ? ['--seed', value] : ['--set', `${key}=${value}`]));
  return [...words, '--out', 'runs/page'].map(quoted).join(' ');
}

// A slider goes through a list of values, to which that of the config is added. `get` is undefined where the config has no such
// setting, and `put` sets a value.
const SLIDERS = [
  {
    id: 'learning_rate', label: () => 'Learning rate', values: [1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3],
    get: config => config.optimizer?.learning_rate, put: value => set('optimizer.learning_rate', value),
  },
  {
    id: 'gamma', label: () => 'Discount γ', values: [0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999, 1],
    get: config => config.gamma, put: value => set('gamma', value),
  },
  {
    id: 'final_epsilon', label: () => 'Exploration ε at the end', values: [0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1],
    get: config => config.exploration?.final, put: value => set('exploration.final', value),
  },
  {
    id: 'width', label: () => 'Units in each hidden layer', values: [2, 4, 8, 16, 24, 32, 64, 128, 256],
    get: config => config.network?.hidden[0], put: (value, config) => set('network.hidden', config.network.hidden.map(() => value)),
  },
  {
    id: 'capacity', label: () => 'Replay memory, transitions', values: [32, 100, 300, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000],
    get: config => config.replay?.capacity, put: value => set('replay.capacity', value),
  },
  {
    id: 'target', label: config => ({ soft: 'Target network: share τ of the way', every_steps: 'Target network: steps between copies', every_episodes: 'Target network: episodes between copies' })[targetKey(config)],
    values: config => ({ soft: [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.3, 1], every_steps: [1, 10, 50, 100, 200, 256, 500, 1000, 2000, 5000], every_episodes: [1, 2, 5, 10, 20, 50] })[targetKey(config)],
    get: config => config.target?.tau ?? config.target?.every_steps ?? config.target?.every_episodes,
    put(value, config) {
      set('target.kind', config.target.kind);
      set(`target.${config.target.kind === 'soft' ? 'tau' : targetKey(config)}`, value);
    },
  },
  {
    id: 'budget', label: config => (config.budget.episodes ? 'Length of the run, episodes' : 'Length of the run, steps'),
    values: config => (config.budget.episodes ? [50, 100, 200, 500, 1000, 2000] : [2000, 5000, 10_000, 20_000, 50_000, 100_000, 200_000]),
    get: config => config.budget.steps ?? config.budget.episodes,
    put: (value, config) => set(config.budget.episodes ? 'budget.episodes' : 'budget.steps', value),
  },
];

function targetKey({ target }) {
  return target?.kind === 'soft' ? 'soft' : target?.every_episodes ? 'every_episodes' : 'every_steps';
}

// Switching a part on again gives back what the preset says.
const SWITCHES = [
  {
    id: 'replay', label: 'Replay memory', get: config => config.replay && config.replay.capacity > config.replay.batch_size,
    put(on, config) {
      settings.sets.delete('replay.capacity');
      if (!on) set('replay.capacity', config.replay.batch_size);
      else if (ownConfig().replay?.capacity <= config.replay.batch_size) set('replay.capacity', 20_000);
    },
  },
  {
    id: 'target_network', label: 'Target network', get: config => config.target && config.target.kind !== 'none',
    put(on, config) {
      unset('target.');
      settings.sets.delete('policy_weights');
      if (!on) {
        set('target.kind', 'none');
        if (config.policy_weights === 'target') set('policy_weights', 'online');
      } else if (ownConfig().target?.kind === 'none') {
        set('target.kind', 'hard');
      }
    },
  },
  { id: 'double', label: 'Double Q-learning', get: config => config.double, put: on => set('double', on) },
  { id: 'mirror', label: 'Mirror images', get: config => config.replay?.mirror, put: on => set('replay.mirror', on) },
];

// The config without what is set on top of it.
const ownConfig = () => parsed(settings.text);
