// The camera in the address of the page, so that it can be shared: #eye=..&target=..&up=..&fov=..
const numbers = (text) => text?.split(',').map(Number);
const short = (vector) => vector.map((x) => Number(x.toPrecision(7))).join(',');

export function readAddress(camera, state) {
  const given = new URLSearchParams(location.hash.slice(1));
  const [eye, target, up] = ['eye', 'target', 'up'].map((name) => numbers(given.get(name)));
  const isPoint = (v) => v?.length === 3 && v.every(Number.isFinite);
  if (isPoint(up)) camera.up = up;
  if (Number(given.get('fov')) > 1) camera.fov = Math.min(170, Number(given.get('fov')));
  if (isPoint(eye) && isPoint(target)) camera.set(eye, target);
  if (given.has('occlusion')) state.occlusion = given.get('occlusion') === '1';
  for (const name of ['tau', 'budget', 'db']) if (Number(given.get(name)) > 0) state[name] = Number(given.get(name));
}

export function writeAddress(camera, state) {
  history.replaceState(null, '', address(camera, state));
}

/** The address of this view. */
export function address(camera, state) {
  const url = new URL(location.href);
  url.hash = `eye=${short(camera.eye)}&target=${short(camera.target)}&up=${short(camera.up)}&fov=${camera.fov}&tau=${state.tau}&budget=${state.budget}${state.db ? `&db=${state.db}` : ''}${state.occlusion ? '&occlusion=1' : ''}`;
  return url.href;
}
