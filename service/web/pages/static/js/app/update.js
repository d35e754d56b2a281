// A page that was opened before the service was updated: its modules are of another version.
const OWN = document.documentElement.dataset.version;
const LOADED_FOR = 'loaded-for-version';
const PATIENCE_MS = 10000;

/** The version of the page that the service has, null where it is this one or cannot be read. */
export async function otherVersion() {
  try {
    const answer = await fetch('/', { cache: 'no-store', signal: AbortSignal.timeout(PATIENCE_MS) });
    const page = new DOMParser().parseFromString(await answer.text(), 'text/html');
    const { version } = page.documentElement.dataset;
    // Once for each: what stands between may have kept the old page.
    const isOther = OWN && version && version !== OWN && sessionStorage.getItem(LOADED_FOR) !== version;
    return isOther ? version : null;
  } catch {
    return null;
  }
}

let isLoading = false; // asked again, a browser would begin again

export function loadVersion(version) {
  if (isLoading) return;
  isLoading = true;
  sessionStorage.setItem(LOADED_FOR, version);
  location.reload();
}
