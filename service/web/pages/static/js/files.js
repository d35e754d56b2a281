// Files that the browser saves.

/** Save something under a name. */
export function saveBlob(name, blob) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

export const saveText = (name, text, type) => saveBlob(name, new Blob([text], { type }));
