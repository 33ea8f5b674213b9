// What may interrupt, or write to memory, ends before memory is set up: interrupts, the core's
// timer, the MPU, DMA. All peripherals are reset at once, as ST's HAL_DeInit does it.
    .pushsection .text.__pre_init, "ax", %progbits
    .global __pre_init
    .type __pre_init, %function
    .thumb_func
__pre_init:
    cpsid i
    movs r0, #0
    msr FAULTMASK, r0
    msr BASEPRI, r0
    msr CONTROL, r0         // the main stack, which was set just now
    isb
    mvn r1, #0

    ldr r2, =0xE000E010     // SYST_CSR
    str r0, [r2]
    ldr r2, =0xE000ED94     // MPU_CTRL
    str r0, [r2]

    ldr r2, =0x40023810     // RCC_AHB1RSTR, AHB2RSTR, AHB3RSTR, APB1RSTR, APB2RSTR
    str r1, [r2]
    str r1, [r2, #0x4]
    str r1, [r2, #0x8]
    str r1, [r2, #0x10]
    str r1, [r2, #0x14]
    str r0, [r2]
    str r0, [r2, #0x4]
    str r0, [r2, #0x8]
    str r0, [r2, #0x10]
    str r0, [r2, #0x14]

    movs r3, #8
    ldr r2, =0xE000E180     // NVIC_ICER0, and NVIC_ICPR0 0x100 later
2:  str r1, [r2, #0x100]
    str r1, [r2], #4
    subs r3, #1
    bne 2b
    ldr r2, =0xE000ED04     // ICSR: PENDSVCLR and PENDSTCLR
    mov r3, #0x0A000000
    str r3, [r2]
    dsb
    isb
    cpsie i
    bx lr
    .ltorg
    .size __pre_init, . - __pre_init
    .popsection
