// Dark or light theme: the system's, until the user selects one.

const KEY = "lumistack-theme";

export function restoreTheme(element: HTMLElement): void {
  if (element.hasAttribute("theme")) return;
  try {
    const kept = localStorage.getItem(KEY);
    if (kept === "dark" || kept === "light") element.setAttribute("theme", kept);
  } catch {
    // Without storage the system's theme stays.
  }
}

export function toggleTheme(element: HTMLElement): void {
  const now = element.getAttribute("theme") ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
  const next = now === "light" ? "dark" : "light";
  element.setAttribute("theme", next);
  try {
    localStorage.setItem(KEY, next);
  } catch {
    // Without storage the theme holds for this visit only.
  }
}
