// Within page.html itself: a file that a changing network has cut off is asked for again, with the whole page.

const again = () => setTimeout(() => location.reload(), 1000);
addEventListener("error", (event) => event.target instanceof HTMLLinkElement && again(), true);
import("./main.js").catch((error) => {
  if (!(error instanceof TypeError)) throw error;
  again();
});
