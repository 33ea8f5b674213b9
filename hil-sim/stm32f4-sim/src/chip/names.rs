//! Names of peripherals and registers (RM0090 2.3), for messages.

/// First address and name of each peripheral, in the order of their addresses; the
/// registers of one go on to the next. Without a name there is nothing.
const PERIPHERALS: &[(u32, &str)] = &[
    (0x4000_0000, "TIM2"),
    (0x4000_0400, "TIM3"),
    (0x4000_0800, "TIM4"),
    (0x4000_0c00, "TIM5"),
    (0x4000_1000, "TIM6"),
    (0x4000_1400, "TIM7"),
    (0x4000_1800, "TIM12"),
    (0x4000_1c00, "TIM13"),
    (0x4000_2000, "TIM14"),
    (0x4000_2400, ""),
    (0x4000_2800, "RTC"),
    (0x4000_2c00, "WWDG"),
    (0x4000_3000, "IWDG"),
    (0x4000_3400, "I2S2ext"),
    (0x4000_3800, "SPI2"),
    (0x4000_3c00, "SPI3"),
    (0x4000_4000, "I2S3ext"),
    (0x4000_4400, "USART2"),
    (0x4000_4800, "USART3"),
    (0x4000_4c00, "UART4"),
    (0x4000_5000, "UART5"),
    (0x4000_5400, "I2C1"),
    (0x4000_5800, "I2C2"),
    (0x4000_5c00, "I2C3"),
    (0x4000_6000, ""),
    (0x4000_6400, "CAN1"),
    (0x4000_6800, "CAN2"),
    (0x4000_6c00, ""),
    (0x4000_7000, "PWR"),
    (0x4000_7400, "DAC"),
    (0x4000_7800, ""),
    (0x4001_0000, "TIM1"),
    (0x4001_0400, "TIM8"),
    (0x4001_0800, ""),
    (0x4001_1000, "USART1"),
    (0x4001_1400, "USART6"),
    (0x4001_1800, ""),
    (0x4001_2000, "ADC1"),
    (0x4001_2100, "ADC2"),
    (0x4001_2200, "ADC3"),
    (0x4001_2300, "ADC"),
    (0x4001_2400, ""),
    (0x4001_2c00, "SDIO"),
    (0x4001_3000, "SPI1"),
    (0x4001_3400, ""),
    (0x4001_3800, "SYSCFG"),
    (0x4001_3c00, "EXTI"),
    (0x4001_4000, "TIM9"),
    (0x4001_4400, "TIM10"),
    (0x4001_4800, "TIM11"),
    (0x4001_4c00, ""),
    (0x4002_0000, "GPIOA"),
    (0x4002_0400, "GPIOB"),
    (0x4002_0800, "GPIOC"),
    (0x4002_0c00, "GPIOD"),
    (0x4002_1000, "GPIOE"),
    (0x4002_1400, "GPIOF"),
    (0x4002_1800, "GPIOG"),
    (0x4002_1c00, "GPIOH"),
    (0x4002_2000, "GPIOI"),
    (0x4002_2400, ""),
    (0x4002_3000, "CRC"),
    (0x4002_3400, ""),
    (0x4002_3800, "RCC"),
    (0x4002_3c00, "FLASH"),
    (0x4002_4000, "BKPSRAM"),
    (0x4002_5000, ""),
    (0x4002_6000, "DMA1"),
    (0x4002_6400, "DMA2"),
    (0x4002_6800, ""),
    (0x4002_8000, "ETH"),
    (0x4002_9400, ""),
    (0x4004_0000, "OTG_HS"),
    (0x4008_0000, ""),
    (0x5000_0000, "OTG_FS"),
    (0x5004_0000, ""),
    (0x5005_0000, "DCMI"),
    (0x5005_0400, ""),
    (0x5006_0000, "CRYP"),
    (0x5006_0400, "HASH"),
    (0x5006_0800, "RNG"),
    (0x5006_0c00, ""),
    (0xa000_0000, "FSMC"),
    (0xa000_1000, ""),
    (0xe004_2000, "DBGMCU"),
    (0xe004_2400, ""),
];

/// Registers by the beginning of their peripheral's name, a word each; a dash is a
/// hole.
const REGISTERS: &[(&str, &str)] = &[
    (
        "TIM",
        "CR1 CR2 SMCR DIER SR EGR CCMR1 CCMR2 CCER CNT PSC ARR RCR CCR1 CCR2 CCR3 CCR4 BDTR DCR \
         DMAR OR",
    ),
    (
        "RTC",
        "TR DR CR ISR PRER WUTR CALIBR ALRMAR ALRMBR WPR SSR SHIFTR TSTR TSDR TSSSR CALR TAFCR \
         ALRMASSR ALRMBSSR",
    ),
    ("WWDG", "CR CFR SR"),
    ("IWDG", "KR PR RLR SR"),
    ("SPI", "CR1 CR2 SR DR CRCPR RXCRCR TXCRCR I2SCFGR I2SPR"),
    ("US", "SR DR BRR CR1 CR2 CR3 GTPR"),
    ("UA", "SR DR BRR CR1 CR2 CR3"),
    ("I2C", "CR1 CR2 OAR1 OAR2 DR SR1 SR2 CCR TRISE FLTR"),
    ("CAN", "MCR MSR TSR RF0R RF1R IER ESR BTR"),
    ("PWR", "CR CSR"),
    (
        "DAC",
        "CR SWTRIGR DHR12R1 DHR12L1 DHR8R1 DHR12R2 DHR12L2 DHR8R2 DHR12RD DHR12LD DHR8RD DOR1 \
         DOR2 SR",
    ),
    (
        "ADC",
        "SR CR1 CR2 SMPR1 SMPR2 JOFR1 JOFR2 JOFR3 JOFR4 HTR LTR SQR1 SQR2 SQR3 JSQR JDR1 JDR2 \
         JDR3 JDR4 DR",
    ),
    (
        "SDIO",
        "POWER CLKCR ARG CMD RESPCMD RESP1 RESP2 RESP3 RESP4 DTIMER DLEN DCTRL DCOUNT STA ICR \
         MASK",
    ),
    (
        "SYSCFG",
        "MEMRMP PMC EXTICR1 EXTICR2 EXTICR3 EXTICR4 - - CMPCR",
    ),
    ("EXTI", "IMR EMR RTSR FTSR SWIER PR"),
    (
        "GPIO",
        "MODER OTYPER OSPEEDR PUPDR IDR ODR BSRR LCKR AFRL AFRH",
    ),
    ("CRC", "DR IDR CR"),
    (
        "RCC",
        "CR PLLCFGR CFGR CIR AHB1RSTR AHB2RSTR AHB3RSTR - APB1RSTR APB2RSTR - - AHB1ENR AHB2ENR \
         AHB3ENR - APB1ENR APB2ENR - - AHB1LPENR AHB2LPENR AHB3LPENR - APB1LPENR APB2LPENR - - \
         BDCR CSR - - SSCGR PLLI2SCFGR PLLSAICFGR DCKCFGR",
    ),
    ("FLASH", "ACR KEYR OPTKEYR SR CR OPTCR"),
    ("RNG", "CR SR DR"),
    (
        "OTG_FS",
        "GOTGCTL GOTGINT GAHBCFG GUSBCFG GRSTCTL GINTSTS GINTMSK GRXSTSR GRXSTSP GRXFSIZ DIEPTXF0 \
         HNPTXSTS - - GCCFG CID - - - - GHWCFG4",
    ),
    ("DBGMCU", "IDCODE CR APB1_FZ APB2_FZ"),
];

/// The peripheral that `address` belongs to, and its first address.
fn peripheral(address: u32) -> Option<(u32, &'static str)> {
    let next = PERIPHERALS.partition_point(|(first, _)| *first <= address);
    let (first, name) = *PERIPHERALS.get(next.checked_sub(1)?)?;
    (!name.is_empty()).then_some((first, name))
}

/// Name of the peripheral that `address` belongs to.
pub(super) fn name(address: u32) -> Option<&'static str> {
    peripheral(address).map(|(_, name)| name)
}

/// True if a peripheral has this name.
#[cfg(test)]
pub(super) fn is_name(name: &str) -> bool {
    PERIPHERALS.iter().any(|(_, known)| *known == name)
}

/// True if the chip has a peripheral there.
pub(super) fn is_peripheral(address: u32) -> bool {
    peripheral(address).is_some()
}

/// The register at `address`, such as `SPI1_SR`.
pub(super) fn register(address: u32) -> String {
    let Some((first, peripheral)) = peripheral(address) else {
        return "a register of no peripheral".to_owned();
    };
    let offset = address - first;
    let name = REGISTERS
        .iter()
        .find(|(beginning, _)| peripheral.starts_with(beginning))
        .and_then(|(_, names)| names.split_whitespace().nth(offset as usize / 4))
        .filter(|name| *name != "-");
    match name {
        Some(name) => format!("{peripheral}_{name}"),
        None => format!("{peripheral} + {offset:#x}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registers_have_the_manuals_names() {
        assert_eq!(register(0x4001_3008), "SPI1_SR");
        assert_eq!(register(0x4001_204c), "ADC1_DR");
        assert_eq!(register(0x4000_4404), "USART2_DR");
        assert_eq!(register(0x4002_3884), "RCC_PLLI2SCFGR");
        assert_eq!(register(0x5006_0808), "RNG_DR");
        assert_eq!(register(0x4002_8004), "ETH + 0x4");
        assert!(!is_peripheral(0x4000_2400));
        assert!(!is_peripheral(0x3fff_fffc));
    }

    #[test]
    fn the_map_is_in_order() {
        assert!(PERIPHERALS.is_sorted_by(|a, b| a.0 < b.0));
    }
}
