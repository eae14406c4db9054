// What the address of a page asks for: the stream, the camera in coordinates of the scene (x right, y down, z forward), a budget.
const query = new URL(location.href).searchParams;
const vector = (name, otherwise) => (query.has(name) ? query.get(name).split(',').map(Number) : otherwise);

export const stream = new URL('../' + query.get('stream'), location.href).href;
export const position = vector('pos', null);
export const target = vector('target', [0, 0, 0]);
export const up = vector('up', [0, -1, 0]);
export const turns = position === null || query.has('turn'); // whether the page can be turned by hand
export const fov = Number(query.get('fov') ?? 50);
export const lod = query.get('lod'); // error: PlayCanvas 2.22 is to choose levels by their errors
export const mode = query.get('mode'); // how the scene was trained: classic, antialiased; null: nobody knows
const asked = Number.parseFloat(query.get('dilation'));
export const dilation = asked >= 0 && asked < Infinity ? asked : 0.3; // px², by which PlayCanvas widens splats; its own is 0.075
export const number = (name, otherwise) => (query.has(name) ? Number(query.get(name)) : otherwise);

// What tests and curious people look at: whether all that the view needs is drawn, and how much that is.
export const state = { ready: false, stop: () => {} };
window.splatree = state;

export function fail(error) {
  state.error = String(error?.message ?? error);
  document.body.append(Object.assign(document.createElement('p'), { className: 'error', textContent: state.error }));
}
