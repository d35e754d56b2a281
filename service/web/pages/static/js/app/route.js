// The address after #: view, asset and what a view keeps there, as in #whatif/bench-2?…

/** { view, asset }; both '' where the address does not say. */
export function readHash() {
  const [path] = location.hash.slice(1).split('?');
  const [view, asset = ''] = path.split('/');
  return { view, asset: decoded(asset) };
}

/** A link that a user has typed may hold a % that is none of an escape. */
function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

export const assetHash = (view, asset) => (asset ? `#${view}/${encodeURIComponent(asset)}` : `#${view}`);

export const readQuery = () => new URLSearchParams(location.hash.split('?')[1] ?? '');

/** Keep it there without opening the view again; what is empty is left out. */
export function keepQuery(values) {
  const query = new URLSearchParams(Object.entries(values).filter(([, value]) => value));
  const [path] = location.hash.split('?');
  history.replaceState(null, '', `${path || '#'}${query.size ? `?${query}` : ''}`);
}
