// Dark or light: what the system says, until the user says otherwise.

const KEY = "lumistack-theme";

export function restoreTheme(element: HTMLElement): void {
  if (element.hasAttribute("theme")) return;
  try {
    const kept = localStorage.getItem(KEY);
    if (kept === "dark" || kept === "light") element.setAttribute("theme", kept);
  } catch {
    // No storage: the system's choice stands.
  }
}

export function toggleTheme(element: HTMLElement): void {
  const now = element.getAttribute("theme") ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
  const next = now === "light" ? "dark" : "light";
  element.setAttribute("theme", next);
  try {
    localStorage.setItem(KEY, next);
  } catch {
    // It holds for this visit alone.
  }
}
