// The address after #: view, asset and what a view keeps there, as in #whatif/bench-2?…

/** { view, asset }; both '' where the address does not say. */
export function readHash() {
  const [path] = location.hash.slice(1).split('?');
  const [view, asset = ''] = path.split('/');
  return { view, asset: decodeURIComponent(asset) };
}

export const assetHash = (view, asset) =>
  (asset ? `#${view}/${encodeURIComponent(asset)}` : `#${view}`);
