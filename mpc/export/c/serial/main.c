/* The board's main loop. A hardware watchdog, if there is one, is best fed here. */
#include "board.h"

int main(void) {
    static ant_board board;
    ant_board_begin(&board);
    for (;;) ant_board_poll(&board);
}
